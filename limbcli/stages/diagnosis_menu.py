"""Measurements that could be added at a site, and what each explanation predicts for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from limbcli.diagnostics.bench import Fitted, Proposal
from limbcli.effects.reading import Curves, Protocol, Reading, read, true_depth
from limbcli.errors import LimbError
from limbcli.model import Array
from limbcli.stages.diagnosis_site import SiteCurves

if TYPE_CHECKING:
    from limbcli.stages.diagnosis_bench import SiteBench

See = Callable[[Curves, Reading, Protocol], Array]
_TARE, _TRAVEL, _THICKNESS, _LEVEL, _PART, _RELAX = 0.05, 0.1, 0.5, 0.05, 0.035, 0.03
_SLOW_S, _FAST_S = 20.0, 0.5
ROTATE = "rotate the probe"
# Effects that a turned probe sees otherwise than the first measurement does.
_TURNS = ("anisotropy", "contraction", "inclusion", "tilt")


def menu(bench: SiteBench, fits: Sequence[Fitted]) -> list[Proposal]:
    """What is not measured yet, as far as it may tell these explanations apart."""
    has = {channel for each in bench.sites for channel in each.site.channels}
    protocol = bench.site.protocol
    n = len(protocol)
    force = np.maximum(0.02 * protocol.force, 0.1)
    found = [
        _proposal(bench, fits, "tare", "tare the load cell in air, at the angle of the measurement",
                  lambda c, r, p: np.array([r.force_zero - r.preload, 10.0 * (r.force_gain - 1)]),
                  np.array([_TARE, 10.0 * 0.01])),
        _proposal(bench, fits, "lift-off", "lift off through thick gel, record where the force vanishes",
                  lambda c, r, p: true_depth(c, np.zeros(1), r), np.array([0.3])),
        _proposal(bench, fits, "two rates", "repeat the ramp to the deepest level in 0.5 s and in 20 s",
                  _two_rates, np.full(1, _RELAX)),
    ]  # fmt: skip
    if "hold" not in has:
        found.append(_proposal(bench, fits, "hold", "hold the deepest level for 60 s, record force and depth",
                               _relaxation, np.full(3, _RELAX)))  # fmt: skip
    if not any(protocol.unloading):
        found.append(_proposal(bench, fits, "unload", "read the levels on the way back too",
                               _unloaded, force[:-1]))  # fmt: skip
    if "skin-bone" not in has:
        found.append(_proposal(bench, fits, "B-mode thickness", "measure skin to bone at first touch",
                               _first_thickness, np.array([_THICKNESS])))  # fmt: skip
    if "travel" not in has:
        found.append(_proposal(bench, fits, "probe travel", "record the probe's absolute travel",
                               lambda c, r, p: read(c, p, r).travel, np.full(n, _TRAVEL)))  # fmt: skip
    if "swe" not in has:
        found.append(_proposal(bench, fits, "wave speeds", "take a shear-wave mean at every level", _mean,
                               np.full(n, _LEVEL)))  # fmt: skip
    if "map" not in has:
        found.append(_proposal(bench, fits, "speed maps", "keep the maps, not only their means",
                               lambda c, r, p: _contrast(read(c, p, r).log_speed), None))  # fmt: skip
    if len(bench.sites) == 1 and any(name in fit.explanation for fit in fits for name in _TURNS):
        found += _rotated(bench, fits)
    return [each for each in found if all(np.all(np.isfinite(v)) for v in each.predictions.values())]


def _first_thickness(curves: Curves, reading: Reading, protocol: Protocol) -> Array:
    return np.array([read(curves, protocol, reading).thickness])


def _mean(curves: Curves, reading: Reading, protocol: Protocol) -> Array:
    return read(curves, protocol, reading).log_speed[:, 0]


def _contrast(log_speed: Array) -> Array:
    """Parts of the window against the mean, every level."""
    return np.asarray(np.nan_to_num(log_speed[:, 1:] - log_speed[:, :1]).ravel())


def _relaxation(curves: Curves, reading: Reading, protocol: Protocol) -> Array:
    """ln of the force lost in a hold of 60 s at the deepest level, after 1, 10 and 60 s."""
    deepest = Protocol(protocol.force[-1:], protocol.depth[-1:], np.zeros(1))
    lost = []
    for seconds in (1.0, 10.0, 60.0):
        held = replace(deepest, hold=np.array([seconds]))
        start, end = read(curves, deepest, reading).force[0], read(curves, held, reading).force[0]
        lost.append(float(np.log(max(end, 1e-6) / max(start, 1e-6))))
    return np.array(lost)


def _two_rates(curves: Curves, reading: Reading, protocol: Protocol) -> Array:
    """ln of the force after a fast ramp over that after a slow one (1,)."""
    deepest = Protocol(protocol.force[-1:], protocol.depth[-1:], np.zeros(1))
    fast, slow = (
        read(curves, replace(deepest, ramp=seconds), reading).force[0] for seconds in (_FAST_S, _SLOW_S)
    )
    return np.array([float(np.log(max(fast, 1e-6) / max(slow, 1e-6)))])


def _unloaded(curves: Curves, reading: Reading, protocol: Protocol) -> Array:
    """Forces at the same depths on the way back (n - 1,)."""
    back = slice(-2, None, -1)
    there_and_back = Protocol(
        np.r_[protocol.force, protocol.force[back]], np.r_[protocol.depth, protocol.depth[back]],
        np.r_[protocol.hold, protocol.hold[back]], protocol.ramp,
    )  # fmt: skip
    return read(curves, there_and_back, reading).force[len(protocol) :]


# ---------------------------------------------------------------- at one site


def _proposal(
    bench: SiteBench, fits: Sequence[Fitted], name: str, sentence: str, see: See, deviation: Array | None
) -> Proposal:
    predictions, jacobians = {}, {}
    for fitted in fits:
        value, jacobian = _seen(bench, fitted, bench.sites[0], see)
        predictions[fitted.explanation], jacobians[fitted.explanation] = value, jacobian
    size = len(next(iter(predictions.values())))
    spread = np.full(size, _PART) if deviation is None else deviation
    return Proposal(name, sentence, predictions, jacobians, np.diag(spread**2))


def _seen(bench: SiteBench, fitted: Fitted, where: SiteCurves, see: See) -> tuple[Array, Array]:
    """The proposal's value at a fit, and its derivative in the fit's own columns."""
    points = bench.points(fitted)
    x = [np.log(fitted.values["c_kpa"] / 1e3), np.log(fitted.values["m"])]
    x += [fitted.values[name] for name in fitted.effect_names]

    def at(values: Array) -> Array:
        theta = bench.theta(
            dict(zip(fitted.effect_names, values[2:].tolist(), strict=True)), fitted.explanation, 0
        )
        c, m = float(np.exp(values[0])), float(np.exp(values[1]))
        curves = where.curves(c, m, fitted.explanation, theta, points)
        return see(curves, where.reading(fitted.explanation, theta, points), where.site.protocol)

    center = np.array(x)
    columns = []
    for k in [0, *([1] if "m" in fitted.base_names else []), *range(2, len(x))]:
        step = 1e-3 * max(abs(center[k]), 0.1)
        up, down = center.copy(), center.copy()
        up[k] += step
        down[k] -= step
        columns.append((at(up) - at(down)) / (2 * step))
    return at(center), np.stack(columns, axis=1)


# ---------------------------------------------------------------- another orientation


def _rotated(bench: SiteBench, fits: Sequence[Fitted]) -> list[Proposal]:
    """The same place with the probe turned by 90 degrees: a whole measurement more."""
    if bench.turned is None:
        return []
    try:
        turned = bench.turned()
    except LimbError:
        return []
    predictions, jacobians = {}, {}
    unknown = np.zeros((len(turned.site.data),) * 2)
    for fitted in fits:
        value, jacobian = _turned(bench, fitted, turned)
        first = jacobian.shape[1] - len(fitted.effect_names)
        for k, slot in enumerate(bench.slots(fitted.explanation)):
            effect = next(e for e in bench.effects.values() if slot.parameter in e.parameters)
            if effect.each_time:  # its size next time is not known
                size = slot.parameter.typical - slot.parameter.null
                unknown += np.outer(jacobian[:, first + k], jacobian[:, first + k]) * size**2
                jacobian[:, first + k] = 0.0
        predictions[fitted.explanation], jacobians[fitted.explanation] = value, jacobian
    covariance = turned.site.data.noise.covariance + unknown
    sentence = "measure the same place again with the probe turned by 90 degrees"
    return [Proposal(ROTATE, sentence, predictions, jacobians, covariance)]


def _turned(bench: SiteBench, fitted: Fitted, turned: SiteCurves) -> tuple[Array, Array]:
    """The turned measurement as a fit predicts it; what changes each time is absent from it."""
    values = dict(fitted.values)
    for slot in bench.slots(fitted.explanation):
        effect = next(e for e in bench.effects.values() if slot.parameter in e.parameters)
        if effect.each_time:
            values[slot.name] = slot.parameter.null
    absent = replace(fitted, values=values)
    return _seen(bench, absent, turned, lambda c, r, p: turned.site.predict(c, r))
