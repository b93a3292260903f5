"""Effects to hide in simulated data, modelled differently from the diagnosis' own models.

Fibres stiffen exponentially instead of quadratically, the skin is thinner than the library's,
relaxation has two terms, wave guidance acts pixel by pixel. The hidden effects are recorded in the truth
file, which no stage reads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limbcli.effects import EFFECTS, effect
from limbcli.effects.effect import Effect, Theta
from limbcli.effects.stiffness_places import layer_share
from limbcli.effects.tissue import fibre_direction, ground_modulus, scaled, with_part
from limbcli.errors import CaseError
from limbcli.measurement.elastography import SweMap
from limbcli.model import Array, IntArray, LimbModel, Material, Value
from limbcli.phantom.protocol import TrueLevels
from limbcli.phantom.simulated_readings import Readings


@dataclass(frozen=True, eq=False, kw_only=True)
class Hidden:
    """A hidden effect: a change of the loaded model, of the model for wave speeds, or of the readings.

    true : entry of the truth file: the parameters as hidden, which can differ from those of the effect's own
        model
    preload : force on the probe at the first level, N
    """

    name: str
    true: Mapping[str, float | Sequence[float]]
    in_model: Callable[[LimbModel], LimbModel] | None = None
    in_readings: Callable[[Readings, TrueLevels], Readings] | None = None
    for_waves: Callable[[LimbModel], LimbModel] | None = None
    preload: float = 0.0

    def facts(self) -> dict[str, Any]:
        return {"effect": self.name, **self.true}


def hide(text: str) -> Hidden:
    """The effect given by "force-zero=1.5" (value of the first parameter) or "skin-layer" (typical size).

    Raises CaseError if the effect is unknown or cannot be hidden, or the size is not a number within its
    bounds.
    """
    name, _, size = text.partition("=")
    found = effect(name, option="--effect")
    first = found.parameters[0]
    theta = found.typical
    if size:
        theta = {**theta, first.name: _number(size, found)}
    model, readings = _MODELS.get(name), _READINGS.get(name)
    if not _can_hide(found):
        fix = f"known here: {', '.join(each.name for each in EFFECTS if _can_hide(each))}"
        raise CaseError(f"{name} cannot be hidden in simulated data", where="--effect", fix=fix)
    in_model = None if readings else (lambda m: (model or found.apply)(m, theta))
    waves = found.waves
    return Hidden(
        name=name, true={**theta, **_otherwise(name, theta)}, in_model=in_model,
        in_readings=None if readings is None else (lambda r, t: readings(r, t, theta)),
        for_waves=None if waves is None else (lambda m: waves(m, theta)),
        preload=theta.get("preload_n", 0.0),
    )  # fmt: skip


def in_order(hidden: Sequence[Hidden]) -> tuple[Hidden, ...]:
    """The effects in the order in which they are applied, independent of the order in which they are given.

    In the model, factors on all stiffnesses come last, as in `effects.effect.applied`; readings are distorted
    in the order of `_READINGS`, from the tissue to the instruments' scales.
    """
    readings = list(_READINGS)

    def place(each: Hidden) -> tuple[bool, int]:
        return effect(each.name).stiffness is not None, readings.index(each.name) if each.in_readings else -1

    return tuple(sorted(hidden, key=place))


def check_beside_layers(hidden: Sequence[Hidden], layers: Sequence[str]) -> None:
    """Refuse skin and fat as hidden effects if the mesh has separate `layers`.

    Raises CaseError if such an effect is among them: it acts at a depth at which the mesh has layers instead
    of tissue.
    """
    found = [each.name for each in hidden if each.name in _BELOW_SKIN]
    if layers and found:
        raise CaseError(
            f"{' and '.join(found)} cannot be hidden where the mesh has separate {' and '.join(layers)}",
            where="--effect",
            fix="omit the effect, or remove [site.layers] from the case",
        )


_BELOW_SKIN = ("skin-layer", "adipose-layer")


def check_beside_numbers(hidden: Sequence[Hidden]) -> None:
    """Refuse another thickness of a limb that is given by numbers: they are what the probe measures.

    Raises CaseError if it is among them.
    """
    if any(each.name == "thickness" for each in hidden):
        raise CaseError(
            "thickness cannot be hidden in a limb given by numbers: the distance to the bone is theirs",
            where="--effect",
            fix="omit the effect, or hide it in a case with images or surfaces",
        )


def _number(size: str, found: Effect) -> float:
    first = found.parameters[0]
    try:
        value = float(size)
    except ValueError:
        value = float("nan")
    if not first.low <= value <= first.high:
        raise CaseError(
            f"{found.name}={size}: {first.name} must be a number from {first.low:g} to {first.high:g}",
            where="--effect", fix=f"for example {found.name}={first.typical:g}",
        )  # fmt: skip
    return value


def _can_hide(found: Effect) -> bool:
    is_its_own = found.solves and not found.febio_only and found.kind != "numerical"
    return found.name in _MODELS or found.name in _READINGS or is_its_own


# ---------------------------------------------------------------- in the tissue, otherwise parametrised

_FIBRE_EXPONENT = 1.5
_SKIN_MM = 1.2
_TERMS = ((0.6, 1.0), (0.4, 20.0))  # (share of the relaxing part, time constant in s)


def _otherwise(name: str, theta: Theta) -> dict[str, float | list[float]]:
    """The parameters of an effect that are hidden with other values than in its own model."""
    if name == "anisotropy":
        return {"fibre_exponent": _FIBRE_EXPONENT}
    if name == "skin-layer":
        return {"log_skin_ratio": float(np.log(_skin_ratio(theta))), "skin_thickness_mm": _SKIN_MM}
    if name == "viscoelasticity":
        parts, times = zip(*_TERMS, strict=True)
        return {"share_of_relaxing": list(parts), "relaxation_time_s": list(times)}
    return {}


def _fibres(model: LimbModel, theta: Theta) -> LimbModel:
    """Add mildly exponential fibres with the same stiffness at small stretch."""
    c = ground_modulus(model)
    fibre: dict[str, Value] = {
        "ksi": theta["fibre_tension_per_c"] * c, "alpha": _FIBRE_EXPONENT, "beta": 2.0, "band": 0.02,
        "mu": theta["fibre_shear_per_c"] * c, "lam0": 1.0, "fiber": fibre_direction(model),
    }  # fmt: skip
    return with_part(model, Material("fiber_exp_pow", fibre))


def _skin(model: LimbModel, theta: Theta) -> LimbModel:
    """Add a thinner skin with the same in-plane stiffness."""
    return scaled(model, 1.0 + layer_share(model, _SKIN_MM) * (_skin_ratio(theta) - 1.0))


def _skin_ratio(theta: Theta) -> float:
    return 1.0 + (float(np.exp(theta["log_skin_ratio"])) - 1.0) * theta["skin_thickness_mm"] / _SKIN_MM


# ---------------------------------------------------------------- in the readings


def _recorded(
    readings: Readings, force: Callable[[Array], Array] = np.asarray,
    depth: Callable[[Array], Array] = np.asarray,
) -> Readings:  # fmt: skip
    """The readings with force and depth transformed, at the levels and in the load cell's record."""
    trace = readings.trace
    record = np.column_stack([trace[:, 0], force(trace[:, 1]), depth(trace[:, 2]), trace[:, 3:]])
    return replace(readings, force=force(readings.force), depth=depth(readings.depth), trace=record)


def _depth_zero(readings: Readings, true: TrueLevels, theta: Theta) -> Readings:
    """Depths are relative to a first frame that is already `depth_zero_mm` deep."""
    shown = _recorded(readings, depth=lambda d: d - theta["depth_zero_mm"])
    return _rows(shown, np.flatnonzero(shown.depth >= 0.0))


def _rows(readings: Readings, keep: IntArray) -> Readings:
    """The readings with only the levels `keep`."""
    left = sorted(set(range(len(readings.force))) - set(keep.tolist()))
    columns = ("force", "depth", "skin_bone", "travel", "layers", "travel_error")
    read = {name: each for name in columns if (each := getattr(readings, name)) is not None}
    maps = tuple(readings.maps[k] for k in keep)
    return replace(
        readings, left_out=tuple(left), maps=maps, **{name: each[keep] for name, each in read.items()}
    )


def _depth_gain(readings: Readings, true: TrueLevels, theta: Theta) -> Readings:
    """Scale all lengths that the images show along the beam by one factor."""
    gain = theta["depth_gain"]
    return replace(
        _recorded(readings, depth=lambda d: d / gain),
        skin_bone=None if readings.skin_bone is None else readings.skin_bone / gain,
        layers=None if readings.layers is None else readings.layers / gain,
    )


def _preload(readings: Readings, true: TrueLevels, theta: Theta) -> Readings:
    """The probe is already under load at the first level; force and depth are relative to that level."""
    force, depth = readings.force[0], readings.depth[0]
    return _recorded(readings, lambda f: f - force, lambda d: d - depth)


def _relaxing(readings: Readings, true: TrueLevels, theta: Theta) -> Readings:
    """Relaxation with two terms, 1 and 20 s; wave speeds are those of the unrelaxed tissue."""
    share = theta["relaxing_share"]
    extra = np.zeros(len(true.force))
    for part, tau in ((part * share, tau) for part, tau in _TERMS):
        state = 0.0
        for k in range(1, len(extra)):
            step = float(true.force[k] - true.force[k - 1])
            fresh = step * tau * -np.expm1(-1.0 / tau)
            state = (state * np.exp(-1.0 / tau) + fresh) * np.exp(-readings.hold / tau)
            extra[k] += part * state
    stiffer = replace(readings, force=readings.force + extra, trace=_relaxing_trace(readings.trace, share))
    return _speeds(stiffer, lambda v, z, k: v * np.sqrt(1 + share))


def _relaxing_trace(trace: Array, share: float) -> Array:
    """The load cell's record with the same relaxation terms, sample by sample."""
    from scipy.signal import lfilter  # takes half a second to import

    step = float(np.median(np.diff(trace[:, 0])))
    elastic, added = trace[:, 1], np.zeros(len(trace))
    for part, tau in _TERMS:
        kept = np.exp(-step / tau)
        added += part * share * lfilter([1.0], [1.0, -kept], np.diff(elastic, prepend=elastic[0]))
    return np.column_stack([trace[:, 0], elastic + added, trace[:, 2:]])


def _support(readings: Readings, true: TrueLevels, theta: Theta) -> Readings:
    """Bone on a spring: the probe's recorded travel exceeds the indentation depth."""
    travel = true.depth + theta["support_compliance_mm_per_n"] * true.force
    error = 0.0 if readings.travel_error is None else readings.travel_error
    return replace(readings, travel=travel - travel[0] + error)


def _guided(readings: Readings, true: TrueLevels, theta: Theta) -> Readings:
    """Change every pixel according to its own speed and the remaining thickness at its level."""
    thick = true.skin_bone if true.skin_bone else 40.0

    def change(v: Array, z: Array, k: int) -> Array:
        height = thick - float(true.depth[min(k, len(true.depth) - 1)])
        ratio = (1e3 * v / (2 * height)) ** 2 * theta["guided_1e4_per_hz2"] * 1e-4
        return np.asarray(v / np.sqrt(1 - np.minimum(ratio, 0.9)))

    return _speeds(readings, change)


def _speeds(readings: Readings, change: Callable[[Array, Array, int], Array]) -> Readings:
    maps = tuple(
        SweMap(m.lateral, m.depth, np.clip(change(m.speed_m_per_s, m.depth, k), 0.3, 20.0), m.path)
        for k, m in enumerate(readings.maps)
    )
    return replace(readings, maps=maps)


_MODELS: dict[str, Callable[[LimbModel, Theta], LimbModel]] = {"anisotropy": _fibres, "skin-layer": _skin}
# In the order in which they are applied: effects before one that removes levels still act on all levels.
_READINGS: dict[str, Callable[[Readings, TrueLevels, Theta], Readings]] = {
    "viscoelasticity": _relaxing,
    "swe-time-scale": lambda r, _, t: _speeds(r, lambda v, z, k: v * t["swe_modulus_scale"] ** -0.5),
    "swe-guided-wave": _guided,
    "swe-depth-bias": lambda r, _, t: _speeds(r, lambda v, z, k: v * (1 - t["swe_loss_per_mm"] * (z - 13.5))),
    "support-motion": _support,
    "preload": _preload,
    "force-gain": lambda r, _, t: _recorded(r, lambda f: f * t["force_gain"]),
    "force-zero": lambda r, _, t: _recorded(r, lambda f: f + t["force_zero_n"]),
    "depth-gain": _depth_gain,
    "depth-zero": _depth_zero,
}
