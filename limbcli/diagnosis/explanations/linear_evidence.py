"""Evidence of one effect more, to first order about a fit: linear algebra alone, for data or for draws.

The draws show what probability of "nothing" occurs by chance where nothing is missing.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.forward_model import Direction, Explanation, Fitted
from limbcli.diagnosis.explanations.laplace import ln_probability
from limbcli.diagnosis.explanations.noise import unit_errors
from limbcli.model import Array
from limbcli.numbers.whitening import Whitener


@dataclass(frozen=True, eq=False)
class Added:
    """Sensitivities of an added effect (or several) at one point of its grid.

    columns : (n, q) whitened; seen : (n, q) the same, as far as the fitted parameters cannot reproduce them
    """

    direction: Direction
    columns: Array
    seen: Array

    @cached_property
    def deviation(self) -> Array:
        """(q,) of the sizes' priors."""
        return np.array([prior.deviation for prior in self.direction.priors.values()])

    @cached_property
    def low(self) -> Array:
        """Limits (q,) of the sizes less their null values."""
        return np.array([prior.low - prior.mean for prior in self.direction.priors.values()])

    @cached_property
    def high(self) -> Array:
        return np.array([prior.high - prior.mean for prior in self.direction.priors.values()])

    @cached_property
    def covariance(self) -> Array:
        """(q, q) of the sizes, given the data, without their limits."""
        return np.asarray(np.linalg.inv(self.columns.T @ self.seen + np.diag(self.deviation**-2.0)))

    @cached_property
    def _constant(self) -> float:
        nothing, prior = np.zeros((1, len(self.low))), np.diag(self.deviation**2)
        inside = ln_probability(nothing, prior, self.low, self.high)
        _, ln_det = np.linalg.slogdet(self.covariance / np.outer(self.deviation, self.deviation))
        return float(0.5 * ln_det - inside[0])

    def sizes(self, residual: Array) -> Array:
        """Mean of the sizes (n_draws, q), without their limits, from whitened residuals (n_draws, n)."""
        return np.asarray(residual @ self.seen @ self.covariance)

    def ln_factor(self, residual: Array) -> Array:
        """ln Bayes factor (n_draws,) of the fit with the effect over that without it."""
        pull = residual @ self.seen
        mean = pull @ self.covariance
        ln = 0.5 * np.einsum("bi,bi->b", pull, mean) + self._constant
        return np.asarray(ln + ln_probability(mean, self.covariance, self.low, self.high))

    def beside(self, other: Added) -> Added:
        a, b = self.direction, other.direction
        point = ", ".join(filter(None, (a.point, b.point)))
        both = Direction(np.hstack([a.columns, b.columns]), {**a.priors, **b.priors}, point, {**a.at, **b.at})
        return Added(both, np.hstack([self.columns, other.columns]), np.hstack([self.seen, other.seen]))


@dataclass(frozen=True, eq=False)
class LinearEvidence:
    """Bayes factors of one effect more about a fit, from one `Added` for each point of each effect's grid.

    residual : (n,) whitened, with the fitted parameters extrapolated to their prior means: what their priors
        hold back at the fit would count as the effect's
    """

    residual: Array
    added: Mapping[str, Sequence[Added]]

    @staticmethod
    def about(
        fitted: Fitted, y: Array, whiten: Whitener, directions: Mapping[str, Sequence[Direction]]
    ) -> LinearEvidence:
        J = whiten(fitted.jacobian)
        normal = J.T @ J + np.diag(fitted.priors.precision)

        def added(each: Direction) -> Added:
            columns = whiten(each.columns)
            return Added(each, columns, columns - J @ np.linalg.solve(normal, J.T @ columns))

        return LinearEvidence(
            whiten(y - fitted.prediction) - J @ fitted.priors.shift,
            {name: [added(each) for each in several] for name, several in directions.items() if several},
        )

    def ln_factor(self, name: str, residual: Array | None = None) -> Array:
        """ln Bayes factor (n_draws,), averaged over the effect's grid; residual : draws instead of data."""
        drawn = self.residual[None] if residual is None else residual
        table = np.array([each.ln_factor(drawn) for each in self.added[name]])
        return np.asarray(np.logaddexp.reduce(table, axis=0) - np.log(len(table)))

    def best(self, name: str) -> Added:
        """The effect at the point of its grid that is most probable."""
        return max(self.added[name], key=lambda each: float(each.ln_factor(self.residual[None])[0]))

    def start(self, names: Sequence[str]) -> dict[str, float]:
        """Sizes (distances from null) and fitted grid values from which a fit with these effects starts."""
        several = [self.best(name) for name in names]
        both = several[0] if len(several) == 1 else several[0].beside(several[1])
        mean = np.clip(both.sizes(self.residual[None])[0], both.low, both.high)
        return {**dict(zip(both.direction.priors, mean.tolist(), strict=True)), **both.direction.at}

    @cached_property
    def ln_factors_of_pairs(self) -> dict[Explanation, float]:
        """ln Bayes factor of all pairs, each effect at the most probable point of its grid."""
        few = {name: self.best(name) for name in self.added}
        lost = {name: -np.log(len(each)) for name, each in self.added.items()}
        return {
            (a, b): float(few[a].beside(few[b]).ln_factor(self.residual[None])[0]) + lost[a] + lost[b]
            for a, b in itertools.combinations(few, 2)
        }


def least_by_chance(linear: LinearEvidence, ln_odds: float, rng: np.random.Generator) -> float:
    """Probability of "nothing" against all single effects (`ln_odds` : of one over nothing), below which a
    share `FALSE_ALARMS` of draws lies: of the noise about the fit without effects, to first order. 0 without
    effects."""
    if not linear.added:
        return 0.0
    drawn = unit_errors(rng, (decisions.N_DRAWS, len(linear.residual)))
    table = np.array([linear.ln_factor(name, drawn) for name in linear.added]) + ln_odds
    ln_something = np.logaddexp.reduce(table, axis=0)
    return float(np.quantile(1.0 / (1.0 + np.exp(ln_something)), decisions.FALSE_ALARMS))
