"""How large each effect could be when it alone is added: an interval for each of its sizes.

To first order at the fit without effects, the tissue refitted: eta +- 1.96 deviations, within what the
parameter's sign allows. Of an effect with a grid (places of a ball, onsets, times) the best point is picked
by chance where nothing is there, and its size with it: the reported one holds the intervals of all points
that chance may put behind the best. Points at which not even a plausible size would show are left out, if
others remain. An effect that was refitted has a second one, on the model with the effect in it: where the two
disagree either may be off, and the reported one holds both. Where an interval reaches a bound the data leave
that side open.

Source: Davies 1987, Biometrika 74:33 (parameters present only off the null).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Direction, Facts, Fitted
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.diagnostics.statistical_tests.multiple_testing import Family, Tested
from limbcli.diagnostics.statistical_tests.score import Trial, scores, visible_columns
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class RefittedSizes:
    """Of an effect that alone was refitted: all values there, and the 95 % intervals of its parameters."""

    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]

    def hull_with(self, others: Mapping[str, tuple[float, float]]) -> RefittedSizes:
        """Each interval the smallest that holds both its own and that of the same name there."""
        ends = {
            name: (min(low, others[name][0]), max(high, others[name][1])) if name in others else (low, high)
            for name, (low, high) in self.intervals.items()
        }
        return replace(self, intervals=ends)


def refitted_sizes(
    fitted: Fitted, jacobian: Array, scale: float, form: Array, widening: float = 1.0
) -> RefittedSizes:
    """The intervals by the sensitivities at the refit, c and m refitted: value +- 1.96 `widening` deviations.

    The refit weighs the data by their noise alone, and the error of the effect's form only widens what it
    tells: weights by an error that grows with the effect itself would leave most to the data that show least
    of it, and find it smaller than it is (Peelle's pertinent puzzle; Fruehwirth, Neudecker and
    Leeb 2012, EPJ Web of Conferences 27:00008).

    jacobian (n, p) : whitened, of all that was fitted, the effect's parameters last; scale : chi2/nu where
    the level of the noise is not known, else 1; form (n, n) : covariance of the form's error, whitened.
    Infinite where the data do not determine a parameter.
    """
    spread = _deviations(jacobian, scale * np.eye(len(jacobian)) + form)
    intervals = {}
    for name, each in zip(fitted.effect_names, spread[len(fitted.base_names) :], strict=True):
        reach = widening * thresholds.SIZE_WITHIN * float(each)
        intervals[name] = fitted.values[name] - reach, fitted.values[name] + reach
    return RefittedSizes(fitted.values, intervals)


def sizes_95(
    state: LinearFit, family: Family, facts: Mapping[str, Facts], trials: Mapping[str, Trial],
    scale: float = 1.0, widening: float = 1.0,
) -> dict[str, dict[str, tuple[float, float]]]:  # fmt: skip
    """Of every candidate in the family that `facts` holds: by parameter, the interval of its distance from
    the null value; infinite where the data do not determine it.

    trials : of the candidates; scale : chi2/nu where the level of the noise is not known, else 1
    widening : times which deviations are taken
    """
    times = widening * float(np.sqrt(scale))
    return {
        each.name: _sizes(state, each, trials[each.name], facts[each.name].typical, times)
        for each in family.tests if each.name in facts
    }  # fmt: skip


def _sizes(
    state: LinearFit, tested: Tested, trial: Trial, typical: Mapping[str, float], times: float
) -> dict[str, tuple[float, float]]:
    """times : of the deviations at noise of 1."""
    least = tested.score.statistic - tested.by_chance
    points = [each for each in scores(state, trial) if each.statistic >= least]
    spreads = [times * _deviations(visible_columns(state, each.direction)) for each in points]
    shown = [_shows(each.direction, spread, typical) for each, spread in zip(points, spreads, strict=True)]
    found: dict[str, tuple[float, float]] = {}
    for each, spread, shows in zip(points, spreads, shown, strict=True):
        if any(shown) and not shows:
            continue
        for name, x, s in zip(each.direction.names, each.eta, spread, strict=True):
            low, high = found.get(name, (np.inf, -np.inf))
            reach = thresholds.SIZE_WITHIN * s
            found[name] = float(min(low, x - reach)), float(max(high, x + reach))
    return found


def _shows(direction: Direction, spread: Array, typical: Mapping[str, float]) -> bool:
    """Whether a plausible size is more than a deviation, for one of the parameters at least."""
    sizes = [abs(typical.get(name, np.inf)) for name in direction.names]
    return bool(np.any(spread < np.array(sizes)))


def _deviations(columns: Array, covariance: Array | None = None) -> Array:
    """Of estimates (p,) by least squares, from whitened sensitivities (n, p); infinite where these are 0.

    covariance (n, n) : of the whitened data, where it is not 1
    """
    lengths = np.linalg.norm(columns, axis=0)
    seen = lengths > 0
    found = np.full(len(lengths), np.inf)
    inverse = np.linalg.pinv(columns[:, seen] / lengths[seen])
    spread = inverse @ inverse.T if covariance is None else inverse @ covariance @ inverse.T
    found[seen] = np.sqrt(np.maximum(np.diag(spread), 0.0)) / lengths[seen]
    return found
