"""Family-wise error control over all tests: minimum-p adjustment by parametric bootstrap.

Under the null hypothesis that no effect is missing, the whitened residual is P e with e of unit standard
deviation. The distribution of every statistic, including suprema over a grid and sign constraints, can
therefore be drawn without any simulation of the tissue.

Where the noise is only assumed, residual and draws are scaled to unit length: the tests then compare shapes
and need no absolute noise level (as an F test does instead of a chi2 test).

Source: Westfall & Young 1993, Resampling-Based Multiple Testing, section 2.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import orth

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.diagnostics.model.noise import ErrorDraws
from limbcli.diagnostics.statistical_tests.localisation_tests import PREFIX
from limbcli.diagnostics.statistical_tests.score import (
    RCOND,
    Score,
    Trial,
    cone_projection,
    score,
    visible_columns,
)
from limbcli.model import Array, IntArray


@dataclass(frozen=True, eq=False)
class Tested:
    """One test: its score, its own p, and its p adjusted over the family.

    p_among : adjusted over the tests of the same kind alone: of the effects, or of the parts of the data
    critical : the statistic that would just be significant after adjustment (in units of the statistic)
    by_chance : the statistic that a fraction `alpha` of all draws exceeds, without adjustment
    """

    name: str
    score: Score
    p: float
    p_adjusted: float
    critical: float
    by_chance: float = 0.0
    p_among: float = 1.0


@dataclass(frozen=True)
class Overall:
    """Test of the whole residual: chi2 on nu degrees of freedom."""

    chi2: float
    nu: int
    p: float
    p_adjusted: float


@dataclass(frozen=True, eq=False)
class Family:
    """All tests of one round; `overall` is None where the noise level is unknown.

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
    errors: ErrorDraws,
    *,
    relative: bool = False,
    alpha: float = thresholds.ALPHA,
    decisive: Sequence[float] = (),
) -> Family:
    """Score every trial and adjust over all of them together with the total chi2.

    relative : the noise level is unknown, and the total chi2 is not tested.
    decisive : decision levels of the adjusted p: the number of draws is doubled, up to `MOST_BATCHES`
        batches, until each adjusted p differs from these by more than its Monte Carlo error.

    Source of the doubling: Besag & Clifford 1991, Sequential Monte Carlo p-values, Biometrika 78:301.
    """
    scores = [score(state, trial) for trial in trials]
    total = state.chi2
    scale = 1.0 / max(total, 1e-300) if relative else 1.0
    values = np.array([each.statistic * scale for each in scores] + ([] if relative else [total]))
    if not len(values):
        return Family((), None, alpha)
    space = _TestSpace.of(state, trials, relative=relative)
    kinds = np.array([each.name.startswith(PREFIX) for each in trials] + ([] if relative else [True]))
    drawn = space.statistics(errors.batch(0))
    adjusted, n = _Adjusted.of(drawn, values, kinds), 1
    while n < thresholds.MOST_BATCHES and not adjusted.clear_of(decisive):
        drawn = np.vstack([drawn, *(space.statistics(errors.batch(k)) for k in range(n, 2 * n))])
        adjusted, n = _Adjusted.of(drawn, values, kinds), 2 * n
    threshold = float(np.quantile(adjusted.smallest, alpha))
    tests = tuple(
        Tested(trial.name, scores[k], adjusted.alone[k], adjusted.p[k],
               float(np.quantile(drawn[:, k], 1 - threshold)) / scale,
               float(np.quantile(drawn[:, k], 1 - alpha)) / scale, adjusted.among[k])
        for k, trial in enumerate(trials)
    )  # fmt: skip
    overall = None if relative else Overall(total, state.nu, adjusted.alone[-1], adjusted.p[-1])
    return Family(tests, overall, threshold)


@dataclass(frozen=True, eq=False)
class _TestSpace:
    """Subspaces in which a family tests: for each direction, an orthonormal basis of its visible columns.

    axes (n, k) : those bases, concatenated; first (d,) : first column of each direction; sign (k,) : 1 or -1
        for one-sided axes, else 0; trial (d,) : index of the test it belongs to
    cones : for directions with several parameters of which some have signs: index of the test, a basis (n,
        r), the visible columns (r, q) in it, and the signs
    fitted (n, p) : basis of the space spanned by the fitted parameters
    """

    axes: NDArray[np.float32]
    first: IntArray
    sign: Array
    trial: IntArray
    cones: tuple[tuple[int, NDArray[np.float32], Array, tuple[int, ...]], ...]
    fitted: NDArray[np.float32]
    n_trials: int
    relative: bool

    @staticmethod
    def of(state: LinearFit, trials: Sequence[Trial], *, relative: bool) -> _TestSpace:
        bases, signs, owners, cones = [np.zeros((len(state.residual), 0))], [], [], []
        for k, trial in enumerate(trials):
            for direction in trial.directions:
                A = visible_columns(state, direction)
                if not np.any(A):
                    continue
                if A.shape[1] > 1 and any(direction.signs):
                    basis = orth(A)
                    cones.append((k, basis.astype(np.float32), basis.T @ A, direction.signs))
                    continue
                one_sided = A.shape[1] == 1
                bases.append(A / np.linalg.norm(A) if one_sided else orth(A, rcond=RCOND))
                signs.append(np.full(bases[-1].shape[1], direction.signs[0] if one_sided else 0))
                owners.append(k)
        first = np.cumsum([0, *(each.shape[1] for each in bases[1:-1])]) if owners else np.zeros(0, np.int64)
        return _TestSpace(
            np.hstack(bases).astype(np.float32), first, np.concatenate([np.zeros(0), *signs]),
            np.array(owners, np.int64), tuple(cones), state.basis.astype(np.float32), len(trials), relative,
        )  # fmt: skip

    def statistics(self, errors: NDArray[np.float32]) -> Array:
        """Statistics (n_draws, n_tests) of errors (n_draws, n); the last is the total, if not relative."""
        total = _squares(errors) - _squares(errors @ self.fitted)
        found = np.zeros((len(errors), self.n_trials + (not self.relative)))
        if len(self.first):
            along = (errors @ self.axes).astype(float)
            one_sided = self.sign != 0
            along[:, one_sided] = np.maximum(along[:, one_sided] * self.sign[one_sided], 0.0)
            by_direction = np.add.reduceat(along**2, self.first, axis=1)
            for k, trial in enumerate(self.trial):
                found[:, trial] = np.maximum(found[:, trial], by_direction[:, k])
        for trial, basis, columns, signs in self.cones:
            length, _ = cone_projection(columns, signs, (errors @ basis).astype(float))
            found[:, trial] = np.maximum(found[:, trial], length)
        if self.relative:
            return found / total[:, None]
        found[:, -1] = total
        return found


def _squares(rows: NDArray[np.float32]) -> Array:
    return np.einsum("bi,bi->b", rows, rows, dtype=float)


@dataclass(frozen=True)
class _Adjusted:
    """Of every test its own p and its p adjusted over all tests, and over those of its kind; and the sorted
    smallest p of each draw."""

    alone: tuple[float, ...]
    p: tuple[float, ...]
    among: tuple[float, ...]
    smallest: Array

    @staticmethod
    def of(drawn: Array, values: Array, kinds: NDArray[np.bool_]) -> _Adjusted:
        """drawn (n_draws, n_tests), values (n_tests,), kinds (n_tests,)"""
        alone = tuple(_p(drawn[:, k], value) for k, value in enumerate(values))
        ranks = np.array([_ranks(each) for each in drawn.T])
        smallest = np.sort(ranks.min(axis=0))
        own = {kind: np.sort(ranks[kinds == kind].min(axis=0)) for kind in set(kinds.tolist())}
        return _Adjusted(
            alone, tuple(_adjust(smallest, p) for p in alone),
            tuple(_adjust(own[kind], p) for p, kind in zip(alone, kinds.tolist(), strict=True)), smallest,
        )  # fmt: skip

    def clear_of(self, decisive: Sequence[float]) -> bool:
        """Whether every adjusted p is clear of these levels by more than its Monte Carlo error.

        The relative error of an adjusted p is at least that of the test's own p, which is far smaller and
        thus rests on the few draws that are as extreme.
        """
        n = len(self.smallest)
        alone, p = np.tile(self.alone, 2), np.array([*self.p, *self.among])
        deviation = p * np.sqrt(1.0 / (n * alone) + (1.0 - p) / (n * p))
        return all((np.abs(p - each) > thresholds.CLEAR_SD * deviation).all() for each in decisive)


def _p(drawn: Array, value: float) -> float:
    return float((1 + np.count_nonzero(drawn >= value)) / (len(drawn) + 1))


def _ranks(drawn: Array) -> Array:
    """p of every draw within its own distribution; about 1 where a one-sided statistic is 0."""
    n = len(drawn)
    out = np.empty(n)
    out[np.argsort(drawn)] = np.arange(n, 0, -1)
    out[drawn <= 0.0] = n
    return out / (n + 1.0)


def _adjust(smallest: Array, p: float) -> float:
    return float((1 + np.searchsorted(smallest, p, side="right")) / (len(smallest) + 1))
