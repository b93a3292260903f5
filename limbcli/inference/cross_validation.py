"""Compliance of people whom the model has not seen, predicted from layer thicknesses by ten-fold
cross-validation with all rows of a person in one fold.

Compliance is the reciprocal of the published stiffness. The prediction is that of the layered slab with the
mean tissue of the site's training people, corrected by a regression on the logarithms of the thicknesses. The
regression has slopes common to all sites and slopes of each site that are shrunken towards them. It minimises
the measure by which it is judged, the mean of |predicted - measured| / measured. How strongly the slopes are
shrunken, and whether the slab helps, is chosen by cross-validation within the training people. Nothing of a
left-out person is used, neither in a mean nor in a scale.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from limbcli.model import Array, IntArray

FOLDS, INNER_FOLDS = 10, 3
_DRAWS = 4000  # bootstrap samples: enough for interval ends that vary by a few hundredths
_SHRINK = ((1.0, 10.0), (1.0, 60.0))  # candidate ridge penalties: (slopes of all sites, slopes of each site)
_INTERCEPT = 1e-3  # ridge penalty of a site's intercept
_CORNER = 0.05  # relative error within which the absolute value is smoothed
_FLAT = 1e-6  # standard deviation below which a feature counts as constant
_STEPS = 60  # largest number of L-BFGS-B iterations

Physics = Callable[[Array], Array]
"""Training rows (n,) bool -> ln compliance of all rows (n,), up to one constant per site."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """fold (n,); predicted compliance (n,); chosen: hyperparameters of each fold."""

    fold: IntArray
    predicted: Array
    chosen: tuple[dict[str, float | bool], ...]


def person_folds(people: Array, n_folds: int, seed: int) -> IntArray:
    """Fold of each row (n,): all rows of a person in the same fold, folds with equal numbers of people."""
    names = np.unique(people.astype(str))
    shuffled = np.random.default_rng(seed).permutation(names)
    number = {name: k % n_folds for k, name in enumerate(shuffled)}
    return np.array([number[str(each)] for each in people], dtype=np.int64)


def percent_off(predicted: Array, measured: Array) -> Array:
    """Relative prediction error |predicted - measured| / measured (n,), percent."""
    return np.asarray(100.0 * np.abs(predicted - measured) / measured)


def mean_interval(people: Array, values: Array, *, seed: int = 7) -> tuple[float, float]:
    """95 % bootstrap interval of the mean of values (n,) over people.

    Percentiles of the means of people resampled with replacement, all rows of a person together (Efron &
    Tibshirani 1993, An Introduction to the Bootstrap, chapters 8 and 13). It does not include that training
    on other people would change the model.
    """
    names, number = np.unique(people.astype(str), return_inverse=True)
    total = np.bincount(number, weights=values)
    count = np.bincount(number).astype(float)
    drawn = np.random.default_rng(seed).integers(len(names), size=(_DRAWS, len(names)))
    means = total[drawn].sum(axis=1) / count[drawn].sum(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def predict_left_out(
    people: Array, sites: Array, features: Array, compliance: Array, physics: Physics, *, seed: int = 7
) -> LeftOut:
    """Compliance of each row from a model of the people in the other nine folds.

    features : (n, k) logarithms of thicknesses and anything else known before the probe is pressed
    """
    fold = person_folds(people, FOLDS, seed)
    predicted, chosen = np.empty(len(fold)), []
    for k in range(FOLDS):
        train = fold != k
        slab = physics(train)
        best = _choose(people, sites, features, compliance, slab, train, seed + 1 + k)
        model = _Regression.fit(sites, features, compliance, slab, train, best)
        predicted[~train] = model(sites, features, slab)[~train]
        names = ("shrink_all", "shrink_site", "with_slab")
        chosen.append(dict(zip(names, best, strict=True)))
    return LeftOut(fold, predicted, tuple(chosen))


def springs_left_out(people: Array, thickness: Array, compliance: Array, *, seed: int = 7) -> Array:
    """Springs in series: compliance = a fat + b muscle of all sites, by least squares on the same folds."""
    return _left_out_by_group(people, np.zeros(len(people)), thickness, compliance, seed)


def lines_left_out(
    people: Array, sites: Array, thickness: Array, compliance: Array, *, seed: int = 7
) -> Array:
    """Linear model of each site: compliance = a + b fat + c muscle, by least squares on the same folds."""
    columns = np.column_stack([np.ones(len(people)), thickness])
    return _left_out_by_group(people, sites.astype(str), columns, compliance, seed)


def _left_out_by_group(people: Array, group: Array, columns: Array, compliance: Array, seed: int) -> Array:
    """Compliance linear in the columns (n, k), with other coefficients in each group (n,)."""
    fold = person_folds(people, FOLDS, seed)
    predicted = np.empty(len(fold))
    for k in range(FOLDS):
        for each in np.unique(group):
            train, test = (group == each) & (fold != k), (group == each) & (fold == k)
            found, *_ = np.linalg.lstsq(columns[train], compliance[train], rcond=None)
            predicted[test] = columns[test] @ found
    return predicted


def _choose(
    people: Array, sites: Array, features: Array, compliance: Array, slab: Array, train: Array, seed: int
) -> tuple[float, float, bool]:
    """Hyperparameters with the smallest error in cross-validation within the training people."""
    inner = person_folds(people, INNER_FOLDS, seed)
    scores: dict[tuple[float, float, bool], float] = {}
    for (all_, site), use in itertools.product(_SHRINK, (True, False)):
        missed, choice = list[Array](), (all_, site, use)
        for k in range(INNER_FOLDS):
            kept, out = train & (inner != k), train & (inner == k)
            if not kept.any() or not out.any():
                continue
            model = _Regression.fit(sites, features, compliance, slab, kept, choice)
            missed.append(percent_off(model(sites, features, slab)[out], compliance[out]))
        scores[choice] = float(np.concatenate(missed).mean())
    return min(scores, key=lambda each: scores[each])


@dataclass(frozen=True, eq=False)
class _Regression:
    """ln compliance = [slab +] intercept of the site + features @ (common slopes + slopes of the site)."""

    names: Sequence[str]
    middle: Array
    scale: Array
    coefficients: Array
    with_slab: bool

    @staticmethod
    def fit(
        sites: Array, features: Array, compliance: Array, slab: Array, train: Array,
        choice: tuple[float, float, bool],
    ) -> _Regression:  # fmt: skip
        """choice : hyperparameters shrink_all, shrink_site, with_slab"""
        shrink_all, shrink_site, with_slab = choice
        kept = features[train]
        middle, scale = kept.mean(axis=0), kept.std(axis=0)
        scale = np.where(scale > _FLAT, scale, np.inf)
        names = sorted(set(sites[train].astype(str).tolist()))
        model = _Regression(names, middle, scale, np.zeros(0), with_slab)
        a = model._design(sites[train], kept)
        target = np.log(compliance[train]) - with_slab * slab[train]
        n, k = len(target), features.shape[1]
        counts = 1, len(names), k, k * len(names)  # of the columns of the design
        penalty = np.repeat([0.0, _INTERCEPT, shrink_all, shrink_site], counts) / n
        start = np.linalg.solve(a.T @ a / n + np.diag(penalty + 1e-9), a.T @ target / n)

        def cost(w: Array) -> tuple[float, Array]:
            ratio = np.exp(np.clip(a @ w - target, -20.0, 20.0))
            off = ratio - 1.0
            rounded = np.sqrt(off**2 + _CORNER**2)
            gradient = a.T @ (off / rounded * ratio) / n + 2.0 * penalty * w
            return float(rounded.mean() + np.sum(penalty * w * w)), gradient

        found = minimize(cost, start, jac=True, method="L-BFGS-B", options={"maxiter": _STEPS})
        return _Regression(names, middle, scale, found.x, with_slab)

    def __call__(self, sites: Array, features: Array, slab: Array) -> Array:
        """Compliance of rows (n,)."""
        return np.asarray(np.exp(self._design(sites, features) @ self.coefficients + self.with_slab * slab))

    def _design(self, sites: Array, features: Array) -> Array:
        z = (features - self.middle) / self.scale
        at = (sites.astype(str)[:, None] == np.array(self.names)[None]).astype(float)
        return np.concatenate(
            [np.ones((len(z), 1)), at, z, *(at[:, [j]] * z for j in range(at.shape[1]))], axis=1
        )
