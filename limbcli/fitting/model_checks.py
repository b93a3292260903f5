"""Effect of the contact and of the model's boundaries on the force: solve the fitted model again with others.

A penalty contact lets the probe penetrate the skin. The penalty is a multiple of the tissue's stiffness at
rest, so where the tissue stiffens (large m, large depth) the penetration grows and the force is too low,
for which the fit compensates with a larger m.

A model is held where it was cut from the limb, and its far side is free. A limb gives way beyond the cut, so
that the force is too high, and where its far side rests on something the force is too low. No column of a
case says how a limb was held. The truth lies between the model and the two extremes, and half of what each
of them changes counts as one standard deviation of the force.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from limbcli.effects.crop import EFFECT as CROP
from limbcli.effects.effect import Effect
from limbcli.effects.far_side import FAR_SIDE
from limbcli.errors import SolveError
from limbcli.inference.adaptive import Intervals
from limbcli.inference.geometry_uncertainty import total_share
from limbcli.inference.joint_fit import JointProblem, joint_fit
from limbcli.inference.prediction import sampled
from limbcli.inference.two_step_fit import CurveMatch
from limbcli.model import Array, LimbModel
from limbcli.numbers.significant_digits import short
from limbcli.progress import SILENT, Progress
from limbcli.results import StageWriter

HARDER = 4.0  # penalty of the check, as a multiple of the model's
MATTERS = 0.05  # relative change of force above which a warning is given; below it the mesh error is larger
_SHARE = 0.5  # standard deviation of ln force, as a share of what the other boundary changes
_FAR = 2.0  # factor on a parameter up to which its linear estimate is given


@dataclass(frozen=True)
class ChangedBoundary:
    """A boundary other than the model's: key in the result, and how a sentence calls it."""

    key: str
    words: str
    effect: Effect

    def of(self, model: LimbModel) -> LimbModel:
        """The model with this boundary; the same object where that is the model's own."""
        return self.effect.apply(model, self.effect.start)


BOUNDARIES = (
    ChangedBoundary("cut_free", "if the cut plane were free", CROP),
    ChangedBoundary("far_side_held", "if the far side of the limb were held", FAR_SIDE),
)


@dataclass(frozen=True, eq=False)
class ChangedForces:
    """Forces with another boundary as ratios (n_reached,) to the model's own; None if not solved, because of
    an error or because the model has no such boundary."""

    boundary: ChangedBoundary
    ratio: Array | None = None
    error: SolveError | None = None


def changed_forces(
    model: LimbModel, forces: Array, again: Callable[[ChangedBoundary], Array], *,
    progress: Progress = SILENT,
) -> list[ChangedForces]:  # fmt: skip
    """The forces of the fitted model with each of `BOUNDARIES`; again : gives those (n_reached,) N with one,
    or raises SolveError."""
    found = []
    for boundary in BOUNDARIES:
        if boundary.of(model) is model:
            found.append(ChangedForces(boundary))
            continue
        progress.event("note", text=f"the fitted model {boundary.words}")
        try:
            solved = again(boundary)
            found.append(ChangedForces(boundary, solved / np.maximum(forces[: len(solved)], 1e-9)))
        except SolveError as error:
            found.append(ChangedForces(boundary, error=error))
    return found


def boundary_modes(changed: Sequence[ChangedForces], depths: Array, knots: Array) -> Array:
    """Changes of ln force (n_modes, n_knots), one standard deviation each: half of what a boundary changes at
    `depths` mm, so that the other extreme lies two deviations from the model; constant beyond the last."""
    changes = [np.log(np.maximum(each.ratio, 1e-9)) for each in changed if each.ratio is not None]
    modes = [_SHARE * np.interp(knots, depths[: len(each)], each) for each in changes]
    return np.array(modes).reshape(len(modes), len(knots))


def allowing_for(
    changed: Sequence[Sequence[ChangedForces]], problem: JointProblem, found: Intervals, *,
    max_solves: int, progress: Progress = SILENT,
) -> tuple[JointProblem, Intervals]:  # fmt: skip
    """A joint fit repeated from its result, with the boundaries' part in the gain of every site.

    changed : by site, the forces with other boundaries. Their root mean square over the levels counts, as a
        gain multiplies all forces. Simulations of the first fit are not repeated.
    """
    shares = [
        total_share(list(boundary_modes(each, data.knots, data.knots)))
        for each, data in zip(changed, problem.task.data, strict=True)
    ]
    if not any(shares):
        return problem, found
    wider = [
        replace(data, gain_deviation=float(np.hypot(data.gain_deviation, share)))
        for data, share in zip(problem.task.data, shares, strict=True)
    ]
    start = found.best[: 1 + problem.n_shape]
    return joint_fit(replace(problem.task, data=wider), [start], max_solves=max_solves, progress=progress)


def write_boundary_check(
    changed: Sequence[ChangedForces], depths: Array, writer: StageWriter, *,
    parameters: Callable[[Array], Mapping[str, float]] | None = None, site: str | None = None,
) -> None:  # fmt: skip
    """Write `boundary_check` of a fit, or of one site of several, and a line of the summary for every
    boundary.

    depths (n_levels,) mm; parameters : ratio of forces (n_reached,) -> what fits the same data with that
    model
    """
    at, found = "" if site is None else f"{site}: ", dict[str, dict[str, object]]()
    _write("boundary_check", site, found, writer)
    for each in changed:
        boundary, ratio = each.boundary, each.ratio
        if ratio is None:
            why = each.error.what if each.error is not None else "the model has no such boundary"
            found[boundary.key] = {"not_evaluated": why}
            if each.error is not None:
                writer.warnings.append(
                    f"{at}the force {boundary.words} was not evaluated: {why}; no interval allows for it"
                )
            continue
        n = len(ratio)
        moved: Mapping[str, float] = {}
        if parameters is not None:
            with suppress(SolveError):  # of the derivatives, where a solver has to run for them
                moved = parameters(ratio)
        found[boundary.key] = {"depths_mm": depths[:n], "force_change_fraction": ratio - 1.0, **moved}
        worst = int(np.argmax(np.abs(ratio - 1.0)))
        words = f"{100 * abs(ratio[worst] - 1.0):.1f} % {'higher' if ratio[worst] > 1 else 'lower'}"
        fits = " and ".join(f"{name} {short(value, 2)}" for name, value in moved.items())
        writer.summary.append(
            f"{at}{boundary.words}, the force would be {words} at {depths[worst]:.1f} mm"
            + (f" (about {fits} would then fit)" if fits else "")
        )


def _write(check: str, site: str | None, content: Mapping[str, object], writer: StageWriter) -> None:
    """Write a check of a fit, or that of one site in a fit of several."""
    if site is None:
        writer.data[check] = content
    else:
        writer.data.setdefault(check, {})[site] = content


def write_contact_check(
    penalty: float, forces: Array, depths: Array, harder: Callable[[float], Array], writer: StageWriter, *,
    site: str | None = None, progress: Progress = SILENT,
) -> None:  # fmt: skip
    """Write `contact_check` of a fit, or of one site of several, a line of the summary, and a warning if the
    change exceeds `MATTERS`. harder : penalty -> forces (n_reached,) N of the same model, or raises
    SolveError"""
    at = "" if site is None else f"{site}: "
    progress.event("note", text=f"the fitted model with {HARDER:g} times the contact's penalty")
    reported = {"penalty": penalty, "tried": HARDER * penalty, "depths_mm": depths}
    try:
        found_forces = harder(HARDER * penalty)
    except SolveError as error:
        _write("contact_check", site, {**reported, "not_evaluated": error.what}, writer)
        writer.warnings.append(f"{at}the force lost to contact penetration was not evaluated: {error.what}")
        return
    n = len(found_forces)
    change = found_forces / np.maximum(forces[:n], 1e-9) - 1.0
    content = {**reported, "depths_mm": depths[:n], "force_change_fraction": change}
    _write("contact_check", site, content, writer)
    worst = int(np.argmax(np.abs(change)))
    words = f"with a contact {HARDER:g} times as stiff the force changes by {100 * change[worst]:+.1f} %"
    where = f"at {depths[worst]:.1f} mm"
    if n < len(depths):
        where += f" (evaluated down to {depths[n - 1]:.1f} mm)"
    writer.summary.append(f"{at}{words} {where}")
    if abs(change[worst]) > MATTERS:
        writer.warnings.append(
            f"{at}the probe sinks into the skin: {words} {where}, and f_kappa and m make up for it. Build "
            f"the model with --contact-penalty {HARDER * penalty:g} and fit again (FEBio may need smaller "
            "steps then)"
        )


def moved_parameters(
    match: CurveMatch, theta: Array, free: Mapping[int, str], depths: Array, ratio: Array
) -> dict[str, float]:
    """The parameters with which a model whose forces at `depths` are `ratio` (n_reached,) times the curve's
    fits the same data: one Gauss-Newton step in their logarithms; none if one of them moves by more than a
    factor of `_FAR`, as a linear estimate says nothing there.

    free : index in theta and name of those that may move
    """
    if not free:
        return {}
    columns = list(free)
    places = match.data.depth[match.data.depth <= depths[len(ratio) - 1]]
    at = sampled(match.curve, match.knots, places, free=columns, fixed=theta)(theta[columns])
    times = np.interp(places, depths[: len(ratio)], ratio)
    slopes = times[:, None] * at.slopes * theta[columns]
    step = np.linalg.lstsq(slopes, at.values * (1.0 - times), rcond=None)[0]
    if np.abs(step).max() > np.log(_FAR):
        return {}
    return dict(zip(free.values(), (theta[columns] * np.exp(step)).tolist(), strict=True))
