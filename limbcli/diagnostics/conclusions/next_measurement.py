"""What to measure next: the proposal with the largest difference between two explanations after refitting.

Source: Atkinson & Fedorov 1975, Biometrika 62:57 (T-optimality).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Fitted, Proposal
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.model import Array

_SIGNIFICANT = float(norm.ppf(thresholds.NEXT_SIGNIFICANT))


@dataclass(frozen=True)
class NextStep:
    """A proposal for one pair of explanations.

    distance_before, distance : between the two, in standard deviations, without and with the proposal
    power : of the proposed measurement alone to distinguish them
    """

    name: str
    sentence: str
    pair: tuple[str, str]
    distance_before: float
    distance: float
    power: float


def separation(a: Fitted, b: Fitted, whiten: Whitener, extra: Proposal | None = None) -> float:
    """Smaller of the two distances |mu_a - (b refitted)|, in standard deviations of the noise."""
    return min(_distance(a, b, whiten, extra), _distance(b, a, whiten, extra))


def _distance(truth: Fitted, rival: Fitted, whiten: Whitener, extra: Proposal | None) -> float:
    gap = whiten(truth.prediction - rival.prediction)
    tangent = whiten(rival.jacobian)
    if extra is not None:
        plus = Whitener.of(extra.covariance)
        difference = extra.predictions[truth.explanation] - extra.predictions[rival.explanation]
        gap = np.concatenate([gap, plus(difference)])
        tangent = np.vstack([tangent, plus(extra.jacobians[rival.explanation])])
    left: Array = LinearFit.of(gap, tangent).left
    return float(np.linalg.norm(left))


def rank_proposals(fits: Sequence[Fitted], proposals: Sequence[Proposal], whiten: Whitener) -> list[NextStep]:
    """Every proposal for every pair of the set, sorted by decreasing power.

    power : of the one-sided likelihood-ratio test between the two at a level of 5 %: Phi(d - 1.645), where
    d^2 is the increase of the squared distance by the proposal. The existing data are not counted, as they
    have failed to distinguish the pair.
    """
    steps = []
    for i, a in enumerate(fits):
        for b in fits[i + 1 :]:
            before = separation(a, b, whiten)
            for proposal in proposals:
                if a.explanation not in proposal.predictions or b.explanation not in proposal.predictions:
                    continue
                distance = separation(a, b, whiten, proposal)
                pair = (" + ".join(a.explanation), " + ".join(b.explanation))
                added = np.sqrt(max(distance**2 - before**2, 0.0))
                power = float(norm.cdf(added - _SIGNIFICANT))
                steps.append(NextStep(proposal.name, proposal.sentence, pair, before, distance, power))
    return sorted(steps, key=lambda step: -step.power)


def best_step(steps: Sequence[NextStep]) -> tuple[str, float] | None:
    """The proposal with the highest mean power over all pairs: (name, power for its worst pair).

    The worst pair does not decide, as nothing may distinguish an explanation from one that contains it.
    """
    powers: dict[str, list[float]] = {}
    for step in steps:
        powers.setdefault(step.name, []).append(step.power)
    if not powers:
        return None
    name = max(powers, key=lambda each: float(np.mean(powers[each])))
    return name, min(powers[name])


def useful_steps(steps: Sequence[NextStep]) -> list[NextStep]:
    """The best proposal's steps for the pairs that it is likely to distinguish (`NEXT_POWER`), by decreasing
    power; empty if no proposal is worth recommending."""
    best = best_step(steps)
    return [
        step for step in sorted(steps, key=lambda step: -step.power)
        if best is not None and step.name == best[0] and step.power >= thresholds.NEXT_POWER
    ]  # fmt: skip
