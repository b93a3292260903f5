"""What to measure next: the proposal that is expected to say most about which explanation is true.

Source: Lindley 1956, Ann Math Stat 27:986 (expected information of an experiment).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from limbcli.diagnosis.explanations.model.forward_model import Proposal
from limbcli.diagnosis.explanations.probabilities import Explained
from limbcli.model import Array

_DRAWS = 300  # of measurements, for each explanation


@dataclass(frozen=True, kw_only=True)
class NextStep:
    """One proposal.

    information_bits : expected fall of the entropy over the compared explanations; entropy_bits : before it
    expected_probability : of the true explanation afterwards, on average; before : as things stand
    """

    name: str
    sentence: str
    information_bits: float
    entropy_bits: float
    expected_probability: float
    before: float


def ranked(
    several: Sequence[Explained], proposals: Sequence[Proposal], rng: np.random.Generator
) -> tuple[NextStep, ...]:
    """The proposals by decreasing information; several : explanations with a posterior."""
    found = []
    for each in proposals:
        members = [one for one in several if one.explanation in each.predictions]
        if len(members) > 1:
            found.append(_expected(members, each, rng))
    return tuple(sorted(found, key=lambda step: -step.information_bits))


def _expected(several: Sequence[Explained], proposal: Proposal, rng: np.random.Generator) -> NextStep:
    """The predictive distribution of a member is normal: the measurement's noise, and what the data leave of
    its parameters."""
    weights = np.array([each.probability for each in several])
    weights = weights / weights.sum()
    means, roots = [], []
    for each in several:
        assert each.posterior is not None
        J = proposal.jacobians[each.explanation]
        covariance = proposal.covariance + J @ each.posterior.covariance @ J.T
        means.append(proposal.predictions[each.explanation] + J @ each.posterior.step)
        roots.append(
            np.linalg.cholesky(
                covariance + 1e-12 * np.trace(covariance) / len(covariance) * np.eye(len(covariance))
            )
        )
    after, left = 0.0, 0.0
    for k, weight in enumerate(weights):
        drawn = means[k] + rng.standard_normal((_DRAWS, len(means[k]))) @ roots[k].T
        ln = np.array([_ln_density(drawn, mean, root) for mean, root in zip(means, roots, strict=True)])
        ln += np.log(weights)[:, None]
        ln -= np.logaddexp.reduce(ln, axis=0)
        p = np.exp(ln)
        after += float(weight) * float(-np.sum(p * ln, axis=0).mean())
        left += float(weight) * float(p[k].mean())
    before = float(-np.sum(weights * np.log(weights)))
    to_bits = 1.0 / math.log(2.0)
    return NextStep(
        name=proposal.name, sentence=proposal.sentence, information_bits=max(before - after, 0.0) * to_bits,
        entropy_bits=before * to_bits, expected_probability=left, before=float(np.sum(weights**2)),
    )  # fmt: skip


def _ln_density(drawn: Array, mean: Array, root: Array) -> Array:
    off = solve_triangular(root, (drawn - mean).T, lower=True)
    return np.asarray(-0.5 * np.sum(off**2, axis=0) - np.log(np.diag(root)).sum())
