"""Confidence intervals for the size of each effect when it alone is added to the model.

The first interval is linear about the fit without effects, with the tissue refitted: eta +- 1.96 standard
deviations; eta respects the sign constraint. For an effect with a grid (places of a ball, onsets, times) that
is absent, the best grid point and its size are a matter of chance: the reported interval covers those of all
points whose statistic is below the best by no more than chance can explain. Points at which not even a
plausible size would be visible are left out if others remain. An effect that was refitted has a second
interval, from the model that includes it: where the two disagree either may be wrong, and the reported
interval covers both. An interval that reaches a bound is open on that side.

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
    """All parameter values of a refit with one effect, and the 95 % intervals of the effect's parameters."""

    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]

    def hull_with(self, others: Mapping[str, tuple[float, float]]) -> RefittedSizes:
        """Extend each interval to cover the one of the same name in `others`."""
        ends = {
            name: (min(low, others[name][0]), max(high, others[name][1])) if name in others else (low, high)
            for name, (low, high) in self.intervals.items()
        }
        return replace(self, intervals=ends)


def refitted_sizes(
    fitted: Fitted, jacobian: Array, scale: float, form: Array, widening: float = 1.0
) -> RefittedSizes:
    """Intervals from the sensitivities at the refit, with c and m refitted: value +- 1.96 `widening` standard
    deviations.

    The refit weights the data by their noise alone, and the model-form error only widens the intervals.
    Weighting by an error that grows with the effect itself would favour the data that show least of the
    effect and bias its size towards zero (Peelle's pertinent puzzle; Fruehwirth, Neudecker and
    Leeb 2012, EPJ Web of Conferences 27:00008).

    jacobian (n, p) : whitened, of all fitted parameters, the effect's last; scale : chi2/nu where
    the noise level is unknown, else 1; form (n, n) : whitened covariance of the form error.
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
    """For every candidate of the family in `facts`: by parameter, the interval of its distance from
    the null value; infinite where the data do not determine it.

    trials : of the candidates; scale : chi2/nu where the noise level is unknown, else 1
    widening : factor on the standard deviations
    """
    times = widening * float(np.sqrt(scale))
    return {
        each.name: _sizes(state, each, trials[each.name], facts[each.name].typical, times)
        for each in family.tests if each.name in facts
    }  # fmt: skip


def _sizes(
    state: LinearFit, tested: Tested, trial: Trial, typical: Mapping[str, float], times: float
) -> dict[str, tuple[float, float]]:
    """times : factor on the standard deviations at unit noise"""
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
    """Whether the typical size exceeds one standard deviation for at least one of the parameters."""
    sizes = [abs(typical.get(name, np.inf)) for name in direction.names]
    return bool(np.any(spread < np.array(sizes)))


def _deviations(columns: Array, covariance: Array | None = None) -> Array:
    """Standard deviations (p,) of least-squares estimates from whitened sensitivities (n, p); infinite where
    these are 0.

    covariance (n, n) : of the whitened data; None: the identity
    """
    lengths = np.linalg.norm(columns, axis=0)
    seen = lengths > 0
    found = np.full(len(lengths), np.inf)
    inverse = np.linalg.pinv(columns[:, seen] / lengths[seen])
    spread = inverse @ inverse.T if covariance is None else inverse @ covariance @ inverse.T
    found[seen] = np.sqrt(np.maximum(np.diag(spread), 0.0)) / lengths[seen]
    return found
