"""Confidence set of explanations: those that are adequate and not significantly worse than the best one."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Direction, Explanation, Fitted
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.model.noise import unit_errors
from limbcli.diagnostics.statistical_tests.multiple_testing import Family
from limbcli.diagnostics.statistical_tests.score import Trial, narrowed, score, statistics
from limbcli.model import Array


@dataclass(frozen=True, eq=False)
class Refit:
    """An explanation after its full refit.

    state : linearised fit, with chi2 and nu; family : the tests of its residual
    gap : deviance above the best of the compared explanations; gap_allowed : the largest gap that chance
    allows (both None before the comparison)
    form_allowances : deviance that the model-form error may leave, by the name of a test of `family`
    """

    fitted: Fitted
    state: LinearFit
    family: Family
    gap: float | None = None
    gap_allowed: float | None = None
    form_allowances: Mapping[str, float] = field(default_factory=dict)

    @property
    def left_p(self) -> float:
        """Smallest adjusted p of the residual, ignoring tests within the allowance for model-form error."""
        beyond = [
            each.p_adjusted
            for each in self.family.tests
            if each.score.statistic > self.form_allowances.get(each.name, 0.0)
        ]
        return min([*beyond, *([self.family.overall.p_adjusted] if self.family.overall else [])], default=1.0)

    @property
    def explanation(self) -> Explanation:
        return self.fitted.explanation

    @property
    def is_adequate(self) -> bool:
        return self.left_p >= thresholds.ADEQUATE

    @property
    def in_set(self) -> bool:
        return not self.fitted.at_bound and self.fits

    @property
    def fits(self) -> bool:
        """Adequate and not significantly worse than the best; a parameter may be on a bound."""
        return self.is_adequate and not self.is_beaten

    def is_close_to(self, members: Sequence[Refit]) -> bool:
        """Slightly below adequacy, but fitting as well as a member: both leave the same scatter, whose level
        does not favour either of them."""
        if self.fitted.at_bound or self.is_adequate or self.left_p < thresholds.BARELY * thresholds.ADEQUATE:
            return False
        return not self.is_beaten and any(
            self.state.chi2 < m.state.chi2 + thresholds.AS_WELL for m in members
        )

    @property
    def gap_beyond_chance(self) -> float:
        """Gap to the best explanation less the largest that chance allows; -inf before the comparison."""
        if self.gap is None or self.gap_allowed is None:
            return -np.inf
        return self.gap - self.gap_allowed

    @property
    def is_beaten(self) -> bool:
        """Whether the gap to the best explanation is larger than chance allows."""
        return self.gap_beyond_chance > thresholds.SLACK


def compare(
    refits: Sequence[Refit], base: Fitted, state: LinearFit, trials: Mapping[Explanation, Trial],
    whiten: Whitener, form_error: Callable[[Fitted], Array], *, rng: np.random.Generator, relative: bool,
) -> list[Refit]:  # fmt: skip
    """Assign each refit its deviance gap and the quantile of that gap if the refit were true.

    Under explanation k the whitened data are mu_k + f_k + e, where mu_k is its prediction and f_k its
    model-form error (covariance `form_error(fitted)`, as in the tests of its residual). The gap is k's
    deviance minus the best one's, each linearised about its own fit (rivals also about the base). The best is
    chosen among the adequate explanations, if there are any.
    """
    eligible = [each for each in refits if not each.fitted.at_bound]
    if not eligible:
        return list(refits)
    eligible = [each for each in eligible if each.is_adequate] or eligible
    best = min(each.state.chi2 for each in eligible)
    scale = best / max(min(each.state.nu for each in eligible), 1) if relative else 1.0
    done = []
    for each in refits:
        allowed = _allowed(each, eligible, base, state, trials, whiten, form_error(each.fitted), rng, scale)
        done.append(replace(each, gap=each.state.chi2 - best, gap_allowed=allowed))
    return done


def _allowed(
    truth: Refit, rivals: Sequence[Refit], base: Fitted, state: LinearFit,
    trials: Mapping[Explanation, Trial], whiten: Whitener, form_error: Array, rng: np.random.Generator,
    scale: float,
) -> float:  # fmt: skip
    form = _root(whiten(whiten(form_error).T))
    n = len(form)
    errors = (
        unit_errors(rng, (thresholds.N_DRAWS_OF_GAPS, n)) * np.sqrt(scale)
        + rng.standard_normal((thresholds.N_DRAWS_OF_GAPS, n)) @ form
    )
    own = _deviance(truth.state, errors)
    seen = state.project((errors + whiten(truth.fitted.prediction - base.prediction)).T).T
    best = own.copy()
    for rival in rivals:
        if rival.explanation == truth.explanation:
            continue
        apart = whiten(truth.fitted.prediction - rival.fitted.prediction)
        best = np.minimum(best, _deviance(rival.state, errors + apart))
        trial = trials.get(rival.explanation)
        if trial is not None:
            best = np.minimum(best, np.sum(seen**2, axis=1) - statistics(state, trial, seen))
        if set(truth.explanation) < set(rival.explanation):  # the rival's additional effects, about the truth
            more = [trials[(name,)] for name in rival.explanation if name not in truth.explanation]
            left = truth.state.project(errors.T).T
            best = np.minimum(best, own - statistics(truth.state, joint_trial(more), left))
    return float(np.quantile(own - best, 1 - thresholds.BEATEN))


def _deviance(state: LinearFit, errors: Array) -> Array:
    """Deviance (n_draws,) that remains of errors (n_draws, n) after a linear refit."""
    return np.asarray(np.sum(state.project(errors.T) ** 2, axis=0))


def _root(covariance: Array) -> Array:
    """Symmetric square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def joint_trial(trials: Sequence[Trial]) -> Trial:
    """Joint trial of several effects, with one direction per combination of their grid points."""
    directions = []
    for several in itertools.product(*(trial.directions for trial in trials)):
        directions.append(
            Direction(
                np.hstack([each.columns for each in several]),
                tuple(sign for each in several for sign in each.signs),
                ", ".join(each.point for each in several if each.point),
                tuple(name for each in several for name in each.names),
                {name: value for each in several for name, value in each.at.items()},
            )
        )
    return Trial(" + ".join(trial.name for trial in trials), tuple(directions))


def best_pairs(state: LinearFit, trials: Sequence[Trial]) -> list[tuple[str, str]]:
    """The `PAIRS_KEPT` pairs of effects that jointly explain most to first order, the best first."""
    found = []
    for a, b in itertools.combinations([narrowed(state, each) for each in trials], 2):
        found.append((score(state, joint_trial([a, b])).statistic, (a.name, b.name)))
    found.sort(key=lambda item: -item[0])
    return [pair for _, pair in found[: thresholds.PAIRS_KEPT]]
