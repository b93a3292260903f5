"""Tissue parameters and sizes of effects, averaged over explanations by their probability.

The posterior of every explanation is normal in ln c, ln m and the sizes, about its fit; the mixture of these
gives the reported values (medians) and 95 % intervals. The prior of ln m is normal, m from 1 to 15 in 95 %:
the range of exponents reported for muscle and limbs. Where the data determine m, it has no influence.

Source: Sengeh et al. 2016, J Mech Behav Biomed Mater 59:379 (m 4.7 in a residual limb); Oddes & Solav 2023 (m
is hard to identify from indentation); Hoeting et al. 1999, Stat Sci 14:382 (model averaging).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.forward_model import Explanation
from limbcli.diagnosis.explanations.laplace import Posterior, Truncated, quantiles, shortest
from limbcli.diagnosis.explanations.linear_evidence import LinearEvidence

USUAL_M, LN_M_DEVIATION = 3.9, 0.69
PRIOR = f"ln m = ln {USUAL_M} with deviation {LN_M_DEVIATION} (m from 1 to 15, 95 %)"
TISSUE = {"c": "c_kpa", "m": "m"}
# Standard deviation of ln c and ln m beside what the data leave: the models' own error that no part of the
# noise describes, as seen where FEBio's sites are explained rightly
# (`tests/benchmarks/figures/diagnosis-febio.md`). Without maps m follows from the rise of the force, which
# bone beside the probe changes.
_MODEL_ERROR, _WITHOUT_MAPS = {"c": 0.05, "m": 0.12}, {"c": 0.05, "m": 0.35}
Intervals = Mapping[str, tuple[float, float]]
_ENDS = (0.5 * (1.0 - decisions.CREDIBLE), 0.5 * (1.0 + decisions.CREDIBLE))


@dataclass(frozen=True, eq=False)
class Estimates:
    """Reported values and 95 % intervals.

    open : by parameter, which ends (low, high) of its interval are limits of the search
    over : number of explanations that were averaged
    """

    values: Mapping[str, float]
    intervals: Intervals = field(default_factory=dict)
    open: Mapping[str, tuple[bool, bool]] = field(default_factory=dict)
    over: int = 1


def estimates(several: Sequence[tuple[float, Posterior]], *, imaged: bool = True) -> Estimates:
    """Estimates over explanations, each with its weight, of c and m, and of the sizes of the first one's
    effects, over those that have them; what has no posterior is as in the first. imaged : there are maps
    among the data"""
    fitted = several[0][1].fitted
    values, intervals, open_ends = dict(fitted.values), {}, {}
    for k, letter in enumerate(fitted.base_names):
        name = TISSUE.get(letter)
        if name is None:
            continue
        members = [(w, p, math.log(p.fitted.values[name])) for w, p in several]
        beside = (_MODEL_ERROR if imaged else _WITHOUT_MAPS).get(letter, 0.0)
        free = [Truncated(w, at + p.step[k], float(np.hypot(p.deviation[k], beside))) for w, p, at in members]
        low, middle, high = quantiles(free, (_ENDS[0], 0.5, _ENDS[1]))
        bounds = [members[0][2] + float(end[k]) for end in (fitted.priors.low, fitted.priors.high)]
        open_ends[name] = (low <= bounds[0], high >= bounds[1])
        low, middle, high = (math.exp(min(max(x, bounds[0]), bounds[1])) for x in (low, middle, high))
        values[name], intervals[name] = middle, (low, high)
    for name in fitted.effect_names:
        found = [_size(w, p, name) for w, p in several if name in p.fitted.effect_names]
        (values[name],), intervals[name] = quantiles(found, (0.5,)), shortest(found, decisions.CREDIBLE)
    return Estimates(values, intervals, open_ends, len(several))


def _size(weight: float, found: Posterior, name: str) -> Truncated:
    """Distribution of an effect's parameter."""
    fitted = found.fitted
    k, at = len(fitted.base_names) + fitted.effect_names.index(name), fitted.values[name]
    low, high = (at + float(end[k]) for end in (fitted.priors.low, fitted.priors.high))
    return Truncated(weight, at + float(found.step[k]), max(float(found.deviation[k]), 1e-12), low, high)


def sizes_95(
    alone: Mapping[Explanation, Posterior], linear: LinearEvidence
) -> dict[str, dict[str, tuple[float, float]]]:
    """95 % interval of every size of an effect when it alone is added: from its fit, and to first order at
    the other points of its grid, by their evidence: of an absent effect the most probable point is a matter
    of chance."""
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for name, points in linear.added.items():
        fit, best = alone.get((name,)), linear.best(name)
        top = float(best.ln_factor(linear.residual[None])[0])
        found[name] = {}
        for q, (size, prior) in enumerate(best.direction.priors.items()):
            several = [] if fit is None else [_size(1.0, fit, size)]
            for each in points:
                if fit is None or each is not best:
                    weight = math.exp(float(each.ln_factor(linear.residual[None])[0]) - top)
                    null, mean = prior.mean, float(each.sizes(linear.residual[None])[0, q])
                    deviation = float(np.sqrt(each.covariance[q, q]))
                    several.append(
                        Truncated(weight, null + mean, deviation, null + each.low[q], null + each.high[q])
                    )
            found[name][size] = shortest(several, decisions.CREDIBLE)
    return found
