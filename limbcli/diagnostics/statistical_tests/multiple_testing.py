"""One family of tests, one false-alarm rate: minimum-p adjustment by parametric bootstrap.

Under "nothing is missing" the whitened residual is P e with e of unit deviation, so that
every statistic's distribution, its suprema and sign rules included, is drawn without a
single simulation of the tissue.

Where the noise is only assumed, residual and draws are scaled to unit length: the tests
then compare shapes and need no absolute level (the analogue of F instead of chi2).

Source: Westfall & Young 1993, Resampling-Based Multiple Testing, section 2.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.diagnostics.model.noise import unit_errors
from limbcli.diagnostics.statistical_tests.score import Score, Trial, score, statistics
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class Tested:
    """One test: its score, p on its own, p adjusted over the family.

    critical : the statistic that would just be significant (in units of the statistic)
    """

    name: str
    score: Score
    p: float
    p_adjusted: float
    critical: float


@dataclass(frozen=True)
class Overall:
    """Everything that is left: chi2 on nu degrees of freedom."""

    chi2: float
    nu: int
    p: float
    p_adjusted: float


@dataclass(frozen=True, eq=False)
class Family:
    """All tests of one round; `overall` is None where the noise's level is not known.

    threshold_p : the p that a single test must reach so that its adjusted p is `alpha`
    """

    tests: tuple[Tested, ...]
    overall: Overall | None
    threshold_p: float

    def of(self, name: str) -> Tested | None:
        return next((each for each in self.tests if each.name == name), None)

    @property
    def smallest(self) -> float:
        several = [each.p_adjusted for each in self.tests]
        return min([*several, *([self.overall.p_adjusted] if self.overall else [])], default=1.0)


def score_family(
    state: LinearFit,
    trials: Sequence[Trial],
    *,
    rng: np.random.Generator,
    relative: bool = False,
    n_draws: int = thresholds.N_DRAWS,
    alpha: float = thresholds.ALPHA,
) -> Family:
    """Score every trial and adjust over all of them, and over the total chi2.

    relative : the noise's level is not known; no test of the total.
    """
    if len(state.residual) > thresholds.MANY_DATA:
        n_draws = min(n_draws, thresholds.N_DRAWS_OF_MANY)
    draws = unit_errors(rng, (n_draws, len(state.residual)))
    draws -= (draws @ state.basis) @ state.basis.T
    drawn_total = np.einsum("bi,bi->b", draws, draws)
    total = state.chi2
    scale = 1.0
    if relative:
        draws /= np.sqrt(drawn_total)[:, None]
        scale = 1.0 / max(total, 1e-300)
    scores = [score(state, trial) for trial in trials]
    drawn = [statistics(state, trial, draws) for trial in trials]
    values = [each.statistic * scale for each in scores]
    if not relative:
        drawn.append(drawn_total)
        values.append(total)
    if not drawn:
        return Family((), None, alpha)
    p_values = [_p(each, value) for each, value in zip(drawn, values, strict=True)]
    smallest = np.sort(np.min([_ranks(each) for each in drawn], axis=0))
    adjusted = [_adjust(smallest, p) for p in p_values]
    threshold = float(np.quantile(smallest, alpha))
    tests = tuple(
        Tested(trial.name, scores[k], p_values[k], adjusted[k],
               float(np.quantile(drawn[k], 1 - threshold)) / scale)
        for k, trial in enumerate(trials)
    )  # fmt: skip
    overall = None if relative else Overall(total, state.nu, p_values[-1], adjusted[-1])
    return Family(tests, overall, threshold)


def _p(drawn: Array, value: float) -> float:
    return float((1 + np.count_nonzero(drawn >= value)) / (len(drawn) + 1))


def _ranks(drawn: Array) -> Array:
    """p of every draw within its own distribution."""
    ordered = np.sort(drawn)
    return (len(drawn) - np.searchsorted(ordered, drawn, side="left")) / (len(drawn) + 1.0)


def _adjust(smallest: Array, p: float) -> float:
    return float((1 + np.searchsorted(smallest, p, side="right")) / (len(smallest) + 1))
