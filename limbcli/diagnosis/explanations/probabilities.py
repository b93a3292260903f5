"""Probabilities of explanations from their evidence and prior odds; the set that follows; what is named."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.evidence.laplace import Posterior
from limbcli.diagnosis.explanations.model.forward_model import Explanation


@dataclass(frozen=True, eq=False)
class Explained:
    """An explanation and its probability.

    posterior : None where the evidence is a linear estimate; simulated : the fit rests on simulations
    """

    explanation: Explanation
    probability: float
    ln_evidence: float
    posterior: Posterior | None
    simulated: bool = False


@dataclass(frozen=True)
class PriorOdds:
    """Prior probabilities of explanations by `n_effects` effects that can be evaluated."""

    n_effects: int
    something: float = decisions.SOMETHING_MISSING
    most_effects: int = 2

    def ln(self, explanation: Explanation) -> float:
        """
        >>> odds = PriorOdds(10)
        >>> [round(math.exp(odds.ln(each)), 4) for each in ((), ("a",), ("a", "b"))]
        [0.4494, 0.0449, 0.0022]
        """
        n, one = max(self.n_effects, 1), self.something
        weights = (1.0 - one, one / n, (one / n) ** 2 if self.most_effects > 1 else 0.0)
        total = sum(w * k for w, k in zip(weights, (1, self.n_effects, n * (n - 1) / 2), strict=True))
        return math.log(weights[len(explanation)] / total)

    @property
    def ln_single(self) -> float:
        """Of a single effect over nothing."""
        return self.ln(("any",)) - self.ln(())


def probabilities(ln_evidence: Mapping[Explanation, float], odds: PriorOdds) -> dict[Explanation, float]:
    """Probability of each explanation: its evidence times its prior, over the sum.

    >>> probabilities({(): 0.0, ("a",): 0.0}, PriorOdds(1, something=0.25, most_effects=1))
    {(): 0.75, ('a',): 0.25}
    """
    ln = np.array([value + odds.ln(each) for each, value in ln_evidence.items()])
    share = np.exp(ln - np.logaddexp.reduce(ln))
    return {each: float(p) for each, p in zip(ln_evidence, share, strict=True)}


def containing(explanation: Explanation, several: Sequence[Explained]) -> float:
    """Probability of all explanations that contain these effects.

    >>> several = [Explained(e, p, 0.0, None) for e, p in ((("a",), 0.6), (("a", "b"), 0.3), ((), 0.1))]
    >>> round(containing(("a",), several), 3)
    0.9
    """
    return sum(each.probability for each in several if set(explanation) <= set(each.explanation))


def credible(several: Sequence[Explained]) -> list[Explained]:
    """The smallest set with the probability `CREDIBLE`; several : the most probable first."""
    total, found = 0.0, []
    for each in several:
        found.append(each)
        total += each.probability
        if total >= decisions.CREDIBLE:
            break
    return found


def named(several: Sequence[Explained]) -> Explanation:
    """The most probable explanation that has, with those that contain it, the probability `CREDIBLE`; none if
    there is no such one. It must be likely itself: of two effects that both show, neither is named alone.

    several : the most probable first
    """
    for each in several:
        likely = each.probability > decisions.UNSETTLED
        if each.explanation and likely and containing(each.explanation, several) >= decisions.CREDIBLE:
            return each.explanation
    return ()
