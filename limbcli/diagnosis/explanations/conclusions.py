"""Results of a diagnosis: the verdict, what the data cannot show, and what to measure next.

Source: Lindley 1956, Ann Math Stat 27:986 (expected information of an experiment).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ndtri

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.estimates import Estimates
from limbcli.diagnosis.explanations.forward_model import Explanation, Facts, Fitted, Proposal
from limbcli.diagnosis.explanations.laplace import Posterior
from limbcli.diagnosis.explanations.linear_evidence import Added
from limbcli.diagnosis.explanations.noise import CommonError
from limbcli.diagnosis.explanations.residuals import Check, Roughness
from limbcli.diagnosis.explanations.search import Explained
from limbcli.model import Array
from limbcli.numbers.whitening import Whitener

_Z = float(ndtri(decisions.POWER))
_DRAWS = 300  # of measurements, for each explanation
Word = Literal["adequate", "named", "ambiguous", "unexplained", "untestable"]


@dataclass(frozen=True, kw_only=True)
class BlindSpot:
    """Detectability of one effect at its typical (a plausible) size.

    visible_fraction : |P H| / |H|, the share of its signature that the fitted parameters cannot reproduce
    detectable_times_typical : the size detected with 80 % power, in units of the typical size
    bias_sd, bias_percent : of each base parameter by the undetected effect, in deviations and per cent
    """

    name: str
    point: str
    visible_fraction: float
    detectable_times_typical: float
    bias_sd: Mapping[str, float]
    bias_percent: Mapping[str, float]

    @property
    def is_undetectable(self) -> bool:
        return self.detectable_times_typical > 1.0

    @property
    def matters(self) -> bool:
        """Whether a typical effect would be undetected and bias a parameter by more than a deviation."""
        return self.is_undetectable and any(
            abs(each) > decisions.BIAS_MATTERS_SD for each in self.bias_sd.values()
        )


def blind_spot(
    name: str, added: Added, typical: Array, nothing: Posterior, whiten: Whitener, *, ln_factor: float
) -> BlindSpot:
    """The effect `added` at one point of its grid, of typical size (q,), beside the fit without effects;
    ln_factor : Bayes factor at which the model is no longer adequate
    """
    moved, seen = added.columns @ typical, added.seen @ typical
    size, information = float(np.linalg.norm(moved)), float(moved @ seen)
    fitted = nothing.fitted
    shift = nothing.covariance @ (whiten(fitted.jacobian).T @ moved)
    of_base = list(zip(fitted.base_names, shift, nothing.deviation, strict=False))
    bias = {key: float(moved_by / max(deviation, 1e-300)) for key, moved_by, deviation in of_base}
    percent = {key: float(100 * np.expm1(np.clip(moved_by, -5, 5))) for key, moved_by, _ in of_base}
    prior = float(np.min((typical / added.deviation)[typical != 0] ** 2)) if np.any(typical) else 0.0
    one_sided = bool(np.any((added.low >= 0.0) | (added.high <= 0.0)))
    needed = ln_factor - (math.log(2.0) if one_sided else 0.0)
    return BlindSpot(
        name=name, point=added.direction.point,
        visible_fraction=math.sqrt(max(information, 0.0)) / size if size > 0 else 0.0,
        detectable_times_typical=_detectable(information, prior, needed), bias_sd=bias, bias_percent=percent,
    )  # fmt: skip


def _detectable(information: float, prior: float, ln_factor: float) -> float:
    """Size, in units of that with this information (reciprocal variance) and prior precision, whose Bayes
    factor exceeds exp(ln_factor) with the stated power; infinite where it is invisible.

    >>> round(_detectable(100.0, 0.0001, 0.0), 3)  # 3.72 standard deviations and 0.84 for the power
    0.456
    """
    if information <= 0.0:
        return math.inf
    needed = 2.0 * (information + prior) / information**2 * (
        ln_factor + 0.5 * math.log1p(information / max(prior, 1e-12))
    )  # fmt: skip
    return math.sqrt(max(needed, 0.0)) + _Z / math.sqrt(information)


@dataclass(frozen=True, kw_only=True)
class NextStep:
    """One proposal: expected fall of the entropy over the compared explanations, and the entropy before it;
    expected probability of the true explanation afterwards, and as things stand (`before`)."""

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
        members = [one for one in several if one.explanation in each.seen]
        if len(members) > 1:
            found.append(_expected(members, each, rng))
    return tuple(sorted(found, key=lambda step: -step.information_bits))


def _expected(several: Sequence[Explained], proposal: Proposal, rng: np.random.Generator) -> NextStep:
    """What a member predicts is normal: by the measurement's noise and its parameters' covariance."""
    weights = np.array([each.probability for each in several])
    weights = weights / weights.sum()
    means, roots = [], []
    for each in several:
        assert each.posterior is not None
        mean, J = proposal.seen[each.explanation]
        covariance = proposal.covariance + J @ each.posterior.covariance @ J.T
        means.append(mean + J @ each.posterior.step)
        nugget = 1e-12 * np.trace(covariance) / len(covariance) * np.eye(len(covariance))
        roots.append(np.linalg.cholesky(covariance + nugget))
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


@dataclass(frozen=True, eq=False)
class Shrink:
    """Goodness of fit at one stage of the model, from the base to the full explanation: of the best fit, by
    channel the rms of residual / standard deviation, and held_out by block, "all" over those that every stage
    predicts."""

    explanation: Explanation
    chi2: float
    nu: int
    rms: Mapping[str, float]
    held_out: Mapping[str, float]
    estimates: Estimates

    @property
    def chi2_per_nu(self) -> float:
        return self.chi2 / max(self.nu, 1)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict and the results it is based on.

    relative : the noise level is unknown (assumed, or contradicted by the scatter)
    nothing, adequate_from : probability that nothing is missing, against all single effects, and the value
        that 95 % of the measurements with nothing missing exceed
    explanations : the most probable first; confidence_set : those that together have 95 %; effects :
        probability of each over all; chosen : what was added to the model (empty if nothing)
    check, left : of the fit without effects, and of the most probable explanation
    sizes : by effect and parameter, the 95 % interval of its value when it alone is added
    common_errors : by fitted explanation, the unknowns that many data have in common
    """

    verdict: Word
    reason: str
    relative: bool
    base: Fitted
    nothing: float
    adequate_from: float
    explanations: tuple[Explained, ...]
    confidence_set: tuple[Explanation, ...]
    effects: Mapping[str, float]
    chosen: Explanation
    check: Check | None
    left: Check | None
    shrink: tuple[Shrink, ...]
    blind_spots: tuple[BlindSpot, ...] = ()
    next_steps: tuple[NextStep, ...] = ()
    not_evaluated: Mapping[str, str] = field(default_factory=dict)
    roughness: Roughness | None = None
    facts: Mapping[str, Facts] = field(default_factory=dict)
    seed: int = 0
    sizes: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)
    common_errors: Mapping[Explanation, tuple[CommonError, ...]] = field(default_factory=dict)

    @property
    def flagged(self) -> tuple[str, ...]:
        """Parts of the data that the fit without effects does not describe."""
        return () if self.check is None else self.check.flagged

    @property
    def estimates(self) -> Estimates:
        """Parameters of the final model, including the chosen effects if there are any."""
        return self.shrink[-1].estimates

    @property
    def fits(self) -> dict[Explanation, Fitted]:
        return {each.explanation: each.posterior.fitted for each in self.explanations if each.posterior}

    @property
    def final(self) -> Fitted:
        return self.fits.get(self.chosen, self.base)
