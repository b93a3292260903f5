"""Effect of the model's boundaries on the force: solve the fitted model again with other ones.

A model is held where it was cut from the limb, and its far side is free. A limb gives way beyond the cut, so
that the force is too high, and where its far side rests on something the force is too low. No column of a
case says how a limb was held. The truth lies between the model and the two extremes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from limbcli.effects.base import Effect
from limbcli.effects.crop import EFFECT as CROP
from limbcli.effects.far_side import FAR_SIDE
from limbcli.errors import SolveError
from limbcli.inference.prediction import SolvedPoints, sampled
from limbcli.inference.two_step_fit import ForceDepth
from limbcli.model import Array, LimbModel
from limbcli.progress import SILENT, Progress
from limbcli.results import StageWriter
from limbcli.significant_digits import short

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


def write_boundary_check(
    model: LimbModel, forces: Array, depths: Array, again: Callable[[ChangedBoundary], Array],
    writer: StageWriter, *, parameters: Callable[[Array], Mapping[str, float]] | None = None,
    site: str | None = None, progress: Progress = SILENT,
) -> None:  # fmt: skip
    """Write `boundary_check` of a fit and a line of the summary for every boundary.

    model, forces (n_levels,) N, depths (n_levels,) mm : the fitted model
    again : the forces (n_reached,) N of the same model with another boundary; raises SolveError
    parameters : ratio of forces (n_reached,) -> the parameters with which that model fits the same data
    site : name of the site, in a fit of several sites, each of which has its own check
    """
    data, at = writer.data, ""
    if site is not None:
        data, at = writer.data.setdefault("boundary_check", {}), f"{site}: "
    found: dict[str, dict[str, object]] = {}
    data["boundary_check" if site is None else site] = found
    for boundary in BOUNDARIES:
        if boundary.of(model) is model:
            found[boundary.key] = {"not_evaluated": "the model has no such boundary"}
            continue
        progress.event("note", text=f"the fitted model {boundary.words}")
        try:
            solved = again(boundary)
        except SolveError as error:
            found[boundary.key] = {"not_evaluated": error.what}
            writer.warnings.append(f"{at}the force {boundary.words} was not evaluated: {error.what}")
            continue
        n = len(solved)
        ratio = solved / np.maximum(forces[:n], 1e-9)
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


def moved_parameters(
    curve: SolvedPoints, knots: Array, data: ForceDepth, theta: Array, free: Mapping[int, str], ratio: Array
) -> dict[str, float]:
    """The parameters with which a model whose forces at `knots` are `ratio` (n_reached,) times the curve's
    fits the same data: one Gauss-Newton step in their logarithms; none if one of them moves by more than a
    factor of `_FAR`, as a linear estimate says nothing there.

    free : index in theta and name of those that may move
    """
    if not free:
        return {}
    columns = list(free)
    reached = data.depth <= knots[len(ratio) - 1]
    at = sampled(curve, knots, data.depth[reached], free=columns, fixed=theta)(theta[columns])
    assert at.jacobian is not None
    times = np.interp(data.depth[reached], knots[: len(ratio)], ratio)
    slopes = times[:, None] * at.jacobian * theta[columns]
    step = np.linalg.lstsq(slopes, at.values * (1.0 - times), rcond=None)[0]
    if np.abs(step).max() > np.log(_FAR):
        return {}
    return dict(zip(free.values(), (theta[columns] * np.exp(step)).tolist(), strict=True))
