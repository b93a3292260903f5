"""Possible further measurements at a site, and what each explanation predicts for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.diagnosis.data.noise_parts import USUAL_THICKNESS, maps_model_error
from limbcli.diagnosis.data.rows import ExtraMeasurement, SmoothDepth
from limbcli.diagnosis.data.site_data import SiteData
from limbcli.diagnosis.explanations.forward_model import Fitted, Proposal
from limbcli.diagnosis.forward_model.predictions import Predictions
from limbcli.diagnosis.forward_model.surrogate import SiteCurves
from limbcli.effects.curves import Curves
from limbcli.effects.reading import Protocol, Reading, read, true_depth
from limbcli.errors import CaseError, LimbError
from limbcli.model import Array

See = Callable[[Curves, Reading, Protocol], Array]
_SLOW_S, _FAST_S = 20.0, 0.5
ROTATE = "rotate the probe"
# Effects that appear different with the probe turned.
_TURNS = ("anisotropy", "contraction")


@dataclass(frozen=True)
class Item:
    """A possible further measurement at a site.

    see : prediction by a model (n,); deviation : standard deviation of the measurement, or, if that is more,
    of_force : as a fraction of the forces read on the way back
    model_error : covariance (n, n) of the model's error in it at a site, where this is relevant
    instead_of : the channel that already contains it, if it was measured
    given, meaning : key of a single number (`--measured KEY=VALUE`), and its meaning
    """

    name: str
    sentence: str
    see: See
    deviation: float
    instead_of: str = ""
    given: str = ""
    meaning: str = ""
    model_error: Callable[[SiteCurves], Array] | None = None
    of_force: float = 0.0

    def deviations(self, protocol: Protocol, n: int) -> Array:
        if not self.of_force:
            return np.full(n, self.deviation)
        return np.maximum(self.of_force * protocol.force[-2::-1][:n], self.deviation)


def items() -> tuple[Item, ...]:
    """All possible further measurements, except that with the probe turned."""
    return (
        Item("tare", "tare the load cell in air, at the angle of the measurement",
             lambda c, r, p: np.array([r.force_zero - r.preload]), 0.05,
             given="tare_n", meaning="N shown by the load cell in air at the angle of the measurement"),
        Item("known weight", "hang a known weight on the load cell",
             lambda c, r, p: np.array([r.force_gain]), 0.01,
             given="force_gain", meaning="shown over true weight"),
        Item("lift-off", "lift off through thick gel, read the depth at which the force vanishes",
             lambda c, r, p: true_depth(c, np.zeros(1), r), 0.3,
             given="first_depth_mm", meaning="mm that the probe was below first touch at level 0"),
        Item("two rates", "repeat the ramp to the deepest level in 0.5 s and in 20 s", _two_rates, 0.03,
             given="rate_ratio", meaning="force after 0.5 s over that after 20 s, at the deepest level"),
        Item("hold", "hold the deepest level for 60 s, record force and depth", _relaxation, 0.03,
             instead_of="hold"),
        Item("unload", "also read the levels during unloading", _unloaded, 0.1, of_force=0.02),
        Item("B-mode thickness", "measure skin to bone at first touch",
             lambda c, r, p: np.array([read(c, p, r).thickness]), 0.5, instead_of="skin-bone"),
        Item("probe travel", "record the probe's absolute travel",
             lambda c, r, p: read(c, p, r).travel, 0.1, instead_of="travel"),
        Item("wave speeds", "take a shear-wave mean at every level",
             lambda c, r, p: read(c, p, r).log_speed[:, 0], 0.05, instead_of="swe"),
        Item("speed maps", "export the maps, not only their means",
             _contrast, 0.035, instead_of="map", model_error=_error_of_contrast),
    )  # fmt: skip


def known(given: Mapping[str, float]) -> list[ExtraMeasurement]:
    """Additionally measured numbers (`--measured`) as data.

    Raises CaseError if a key is not on the menu, or a ratio is not above 0.
    """
    by_key = {item.given: item for item in items() if item.given}
    found = []
    for key, value in given.items():
        if key not in by_key:
            fix = "; ".join(f"{k}: {item.meaning}" for k, item in by_key.items())
            raise CaseError(f"{key!r} is not known", where="--measured", fix=fix)
        item = by_key[key]
        if not np.isfinite(value) or (key == "rate_ratio" and value <= 0):
            raise CaseError(f"{key}={value:g} cannot be", where="--measured", fix=item.meaning)
        y = np.array([np.log(value) if key == "rate_ratio" else value])
        found.append(ExtraMeasurement(item.name, item.see, y, np.full(1, item.deviation)))
    return found


def menu(
    predictions: Predictions, fits: Sequence[Fitted], turned: Callable[[], SiteCurves] | None = None
) -> list[Proposal]:
    """Proposals of measurements not made yet, with the prediction of each of these fits.

    turned : gives the curves with the probe turned by 90 degrees
    """
    has = {channel for each in predictions.sites for channel in _there(each.site)}
    has |= {"unload"} if any(predictions.site.protocol.unloading) else set()
    open_items = [item for item in items() if item.instead_of not in has and item.name not in has]
    found = [_proposal(predictions, fits, item) for item in open_items]
    # Only for single effects: combinations would each need a simulation of the turned model.
    if len(predictions.sites) == 1 and any(fit.explanation == (name,) for fit in fits for name in _TURNS):
        found += _rotated(predictions, fits, turned)
    return [each for each in found if all(np.all(np.isfinite(v)) for v, _ in each.seen.values())]


def _there(site: SiteData) -> set[str]:
    """Channels that need no further measurement; mean speeds only if at least half of the levels have one."""
    n_speeds = site.rows.among("swe").sum()
    in_part = "map" not in site.channels and 2 * n_speeds < len(site.protocol)
    return set(site.channels) - ({"swe"} if in_part else set())


def _contrast(curves: Curves, reading: Reading, protocol: Protocol) -> Array:
    """ln speeds of the parts of the window relative to the mean, at every level."""
    log_speed = read(curves, protocol, reading).log_speed
    return np.asarray(np.nan_to_num(log_speed[:, 1:] - log_speed[:, :1]).ravel())


def _error_of_contrast(site: SiteCurves) -> Array:
    """Covariance of `_contrast` from the model error in maps."""
    protocol, middles = site.site.protocol, site.simulations.windows.middles
    thickness = site.thickness if site.thickness > 0 else USUAL_THICKNESS
    strain = np.abs(SmoothDepth.through(protocol).at(protocol.force)) / thickness
    level, part = (each.ravel() for each in np.indices((len(protocol), len(middles))))
    of_parts = maps_model_error(middles, part, strain[level], level)
    less_mean = np.kron(np.eye(len(protocol)), np.eye(len(middles)) - 1.0 / len(middles))
    return np.asarray(less_mean @ of_parts @ less_mean.T)


def _relaxation(curves: Curves, reading: Reading, protocol: Protocol) -> Array:
    """ln of the force over that at the start of a hold at the deepest level, after 1, 10 and 60 s."""
    start = protocol.deepest
    held = [replace(start, hold=np.array([seconds])) for seconds in (1.0, 10.0, 60.0)]
    return np.array([_ln_ratio(curves, reading, each, start) for each in held])


def _two_rates(curves: Curves, reading: Reading, protocol: Protocol) -> Array:
    """ln of the force after a fast ramp over that after a slow one (1,)."""
    fast, slow = (replace(protocol.deepest, ramp=seconds) for seconds in (_FAST_S, _SLOW_S))
    return np.array([_ln_ratio(curves, reading, fast, slow)])


def _ln_ratio(curves: Curves, reading: Reading, one: Protocol, other: Protocol) -> float:
    """ln of the force at the first level of one protocol over that of another."""
    force, beside = (max(read(curves, each, reading).force[0], 1e-6) for each in (one, other))
    return float(np.log(force / beside))


def _unloaded(curves: Curves, reading: Reading, protocol: Protocol) -> Array:
    """Forces at the same depths during unloading (n - 1,)."""
    back = slice(-2, None, -1)
    there_and_back = Protocol(
        np.r_[protocol.force, protocol.force[back]], np.r_[protocol.depth, protocol.depth[back]],
        np.r_[protocol.hold, protocol.hold[back]], protocol.ramp,
    )  # fmt: skip
    return read(curves, there_and_back, reading).force[len(protocol) :]


def _proposal(predictions: Predictions, fits: Sequence[Fitted], item: Item) -> Proposal:
    site = predictions.sites[0]
    seen = {fitted.explanation: _seen(predictions, fitted, site, item.see) for fitted in fits}
    size = len(next(iter(seen.values()))[0])
    covariance = np.diag(item.deviations(site.site.protocol, size) ** 2)
    if item.model_error is not None:
        covariance = covariance + item.model_error(site)
    return Proposal(item.name, item.sentence, seen, covariance)


def _seen(predictions: Predictions, fitted: Fitted, where: SiteCurves, see: See) -> tuple[Array, Array]:
    """Prediction of the proposed measurement at a fit, and its Jacobian with the columns of the fit's."""
    model, center = predictions.model_of(fitted), predictions.x_of(fitted)

    def at(x: Array) -> Array:
        c, m, thetas = predictions.values_of(x, fitted.explanation)
        return see(*where.read(c, m, model, thetas[0]), where.site.protocol)

    columns = []
    for k in range(len(center)):
        step = np.zeros(len(center))
        step[k] = 1e-3 * max(abs(center[k]), 0.1)
        columns.append((at(center + step) - at(center - step)) / (2 * step[k]))
    return at(center), np.stack(columns, axis=1)


def _rotated(
    predictions: Predictions, fits: Sequence[Fitted], turned: Callable[[], SiteCurves] | None
) -> list[Proposal]:
    """Proposal to repeat the whole measurement at the same place with the probe turned by 90 degrees."""
    if turned is None:
        return []
    try:
        other = turned()
    except LimbError:
        return []
    seen, unknown = {}, np.zeros((len(other.site.data),) * 2)
    for fitted in fits:
        slots = predictions.slots(fitted.explanation)
        null = {slot.name: slot.parameter.null for slot in slots if slot.each_time}
        absent = replace(fitted, values={**fitted.values, **null})
        value, jacobian = _seen(predictions, absent, other, lambda c, r, p: other.site.predict(c, r))
        for k, slot in enumerate(slots, jacobian.shape[1] - len(slots)):
            if slot.each_time:  # its size differs in every measurement and is unknown in the next
                size = slot.parameter.typical - slot.parameter.null
                unknown += np.outer(jacobian[:, k], jacobian[:, k]) * size**2
                jacobian[:, k] = 0.0
        seen[fitted.explanation] = value, jacobian
    sentence = "measure the same place again with the probe turned by 90 degrees"
    return [Proposal(ROTATE, sentence, seen, other.site.data.noise.covariance + unknown)]
