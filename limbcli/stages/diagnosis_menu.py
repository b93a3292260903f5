"""Measurements that could be added at a site, and what each explanation predicts for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from limbcli.diagnostics.bench import Fitted, Proposal
from limbcli.effects.base import Theta
from limbcli.effects.reading import Curves, Protocol, Reading, read, true_depth
from limbcli.model import Array

if TYPE_CHECKING:
    from limbcli.stages.diagnosis_bench import SiteBench

See = Callable[[Curves, Reading, Protocol], Array]
_TARE, _TRAVEL, _THICKNESS, _LEVEL, _PART, _RELAX = 0.05, 0.1, 0.5, 0.05, 0.035, 0.03


def menu(bench: SiteBench, fits: Sequence[Fitted]) -> list[Proposal]:
    """What is not measured yet: tare, travel, B-mode thickness, speeds, maps, longer holds."""
    has = set(bench.site.channels)
    protocol = bench.site.protocol
    n = len(protocol)
    found = [
        _proposal(bench, fits, "tare", "tare the load cell in air, at the angle of the measurement",
                  lambda c, r, p: np.array([r.force_zero - r.preload, 10.0 * (r.force_gain - 1)]),
                  np.array([_TARE, 10.0 * 0.01])),
        _proposal(bench, fits, "hold", "hold the deepest level for 60 s and record the force (60 Hz)",
                  _relaxation, np.full(3, _RELAX)),
        _proposal(bench, fits, "lift-off", "lift off through thick gel, record where the force vanishes",
                  lambda c, r, p: true_depth(c, np.zeros(1), r), np.array([0.3])),
    ]  # fmt: skip
    if "skin-bone" not in has:
        found.append(_proposal(bench, fits, "B-mode thickness", "measure skin to bone at first touch",
                               lambda c, r, p: np.array([c.thickness]), np.array([_THICKNESS])))  # fmt: skip
    if "travel" not in has:
        found.append(_proposal(bench, fits, "probe travel", "record the probe's absolute travel",
                               lambda c, r, p: read(c, p, r).travel, np.full(n, _TRAVEL)))  # fmt: skip
    if "swe" not in has:
        found.append(_proposal(bench, fits, "wave speeds", "take a shear-wave mean at every level", _mean,
                               np.full(n, _LEVEL)))  # fmt: skip
    if "map" not in has:
        found.append(_proposal(bench, fits, "speed maps", "keep the maps, not only their means",
                               lambda c, r, p: _contrast(read(c, p, r).log_speed), None))  # fmt: skip
    return [each for each in found if all(np.all(np.isfinite(v)) for v in each.predictions.values())]


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
        held = Protocol(deepest.force, deepest.depth, np.array([seconds]))
        start, end = read(curves, deepest, reading).force[0], read(curves, held, reading).force[0]
        lost.append(float(np.log(max(end, 1e-6) / max(start, 1e-6))))
    return np.array(lost)


def _proposal(
    bench: SiteBench, fits: Sequence[Fitted], name: str, sentence: str, see: See, deviation: Array | None
) -> Proposal:
    predictions, jacobians = {}, {}
    for fitted in fits:
        value, jacobian = _seen(bench, fitted, see)
        predictions[fitted.explanation], jacobians[fitted.explanation] = value, jacobian
    size = len(next(iter(predictions.values())))
    spread = np.full(size, _PART) if deviation is None else deviation
    return Proposal(name, sentence, predictions, jacobians, np.diag(spread**2))


def _seen(bench: SiteBench, fitted: Fitted, see: See) -> tuple[Array, Array]:
    """The proposal's value at a fit, and its derivative in the fit's own columns."""
    effects = [bench.effects[name] for name in fitted.explanation]
    points = bench._points(effects, fitted)
    x = [np.log(fitted.values["c_kpa"] / 1e3), np.log(fitted.values["m"])]
    x += [fitted.values[name] for name in fitted.effect_names]

    def at(values: Array) -> Array:
        theta = dict(zip(fitted.effect_names, values[2:].tolist(), strict=True))
        return _value(bench, fitted, values, theta, points, see)

    center = np.array(x)
    value = at(center)
    columns = []
    used = [0, *([1] if "m" in fitted.base_names else []), *range(2, len(x))]
    for k in used:
        step = 1e-3 * max(abs(center[k]), 0.1)
        up, down = center.copy(), center.copy()
        up[k] += step
        down[k] -= step
        columns.append((at(up) - at(down)) / (2 * step))
    return value, np.stack(columns, axis=1)


def _value(
    bench: SiteBench, fitted: Fitted, x: Array, theta: Theta, points: Sequence[Theta], see: See
) -> Array:
    curves = bench.curves(float(np.exp(x[0])), float(np.exp(x[1])), fitted.explanation, theta, points)
    return see(curves, bench.reading(fitted.explanation, theta, points), bench.site.protocol)
