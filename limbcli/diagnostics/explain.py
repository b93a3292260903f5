"""The confidence set of explanations: every one that fits by itself and is not beaten beyond chance."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.diagnostics.bench import Explanation, Fitted
from limbcli.diagnostics.calibrate import Family
from limbcli.diagnostics.linear import LinearFit, Whitener
from limbcli.diagnostics.noise import unit_errors
from limbcli.diagnostics.score import Direction, Trial, score, statistics
from limbcli.model import Array

LEVEL = 0.025  # of the test against the best of the set
ADEQUATE = 0.01  # of the tests of what is left: the model's own error is known only roughly
_SLACK = 0.5  # deviance within which two fits are the same, whatever the draws say
_N_DRAWS = 4000
_PAIRS_KEPT = 12


@dataclass(frozen=True, eq=False)
class Refit:
    """An explanation after its full refit.

    chi2, nu; family : the tests of what it leaves; gap : deviance to the best of its size, and
    the largest gap that chance allows it (None before the comparison)
    """

    fitted: Fitted
    state: LinearFit
    family: Family
    gap: float | None = None
    gap_allowed: float | None = None

    @property
    def explanation(self) -> Explanation:
        return self.fitted.explanation

    @property
    def is_adequate(self) -> bool:
        return self.family.smallest >= ADEQUATE

    @property
    def in_set(self) -> bool:
        return not self.fitted.at_bound and self.fits

    @property
    def fits(self) -> bool:
        """Adequate, and not beaten beyond chance; perhaps with a parameter on a bound."""
        if not self.is_adequate:
            return False
        return self.gap is None or self.gap_allowed is None or self.gap <= self.gap_allowed + _SLACK


def compare(
    refits: Sequence[Refit], base: Fitted, state: LinearFit, trials: Mapping[Explanation, Trial],
    whiten: Whitener, form_error: Callable[[Fitted], Array], *, rng: np.random.Generator, relative: bool,
) -> list[Refit]:  # fmt: skip
    """Give each refit its deviance gap and the quantile of that gap were it the truth.

    Under explanation k the whitened data are P(mu_k + f_k + e), mu_k the finite change that k
    makes to the prediction, f_k the error of its form (covariance `form_error(fitted)`, the same that the
    tests of what it leaves allow for); the gap is (best score over all - score of k), to first order.
    """
    eligible = [each for each in refits if not each.fitted.at_bound]
    if not eligible:
        return list(refits)
    best = min(each.state.chi2 for each in eligible)
    scale = best / max(min(each.state.nu for each in eligible), 1) if relative else 1.0
    done = []
    for each in refits:
        allowed = _allowed(each, eligible, base, state, trials, whiten, form_error(each.fitted), rng, scale)
        done.append(Refit(each.fitted, each.state, each.family, each.state.chi2 - best, allowed))
    return done


def _allowed(
    truth: Refit, rivals: Sequence[Refit], base: Fitted, state: LinearFit,
    trials: Mapping[Explanation, Trial], whiten: Whitener, form_error: Array, rng: np.random.Generator,
    scale: float,
) -> float:  # fmt: skip
    shift = state.project(whiten(truth.fitted.prediction - base.prediction))
    form = _root(whiten(whiten(form_error).T))
    draws = unit_errors(rng, (_N_DRAWS, len(shift))) * np.sqrt(scale)
    draws = draws + rng.standard_normal((_N_DRAWS, len(shift))) @ form
    draws = state.project((draws + shift).T).T
    tangent = Trial("", (_tangent(truth, whiten),))
    own = statistics(state, tangent, draws)
    top = own.copy()
    for rival in rivals:
        if rival.explanation == truth.explanation:
            continue
        trial = trials.get(rival.explanation)
        if set(truth.explanation) < set(rival.explanation):  # what it has more, beside its own tangent
            more = [trials[(name,)] for name in rival.explanation if name not in truth.explanation]
            trial = joint_trial([tangent, *more])
        if trial is not None:
            top = np.maximum(top, statistics(state, trial, draws))
    return float(np.quantile(top - own, 1 - LEVEL))


def _root(covariance: Array) -> Array:
    """Symmetric square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _tangent(truth: Refit, whiten: Whitener) -> Direction:
    """What an explanation's own parameters move at its fit (its size is not small there)."""
    columns = whiten(truth.fitted.jacobian[:, len(truth.fitted.base_names) :])
    return Direction(columns, (0,) * columns.shape[1])


def joint_trial(trials: Sequence[Trial]) -> Trial:
    """Several effects at once: every combination of their grid points."""
    directions = []
    for several in itertools.product(*(trial.directions for trial in trials)):
        directions.append(
            Direction(
                np.hstack([each.columns for each in several]),
                tuple(sign for each in several for sign in each.signs),
                ", ".join(each.point for each in several if each.point),
                tuple(name for each in several for name in each.names),
            )
        )
    return Trial(" + ".join(trial.name for trial in trials), tuple(directions))


def best_pairs(state: LinearFit, trials: Sequence[Trial]) -> list[tuple[str, str]]:
    """Pairs of effects in the order of what they explain together, to first order; the best few."""
    found = []
    for a, b in itertools.combinations(trials, 2):
        found.append((score(state, joint_trial([a, b])).statistic, (a.name, b.name)))
    found.sort(key=lambda item: -item[0])
    return [pair for _, pair in found[:_PAIRS_KEPT]]
