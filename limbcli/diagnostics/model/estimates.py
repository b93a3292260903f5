"""Tissue parameters under an explanation: intervals from the profile deviance, and one reported value.

An added effect can explain data that otherwise determine a parameter: with guided waves in the model, for
example, the speeds no longer bound m from below. The deviance is then flat in m, sometimes with two minima,
and chance decides which is the deeper one. The deviance is therefore profiled over the whole range of m, with
every other parameter refitted at each value:

- interval: all m whose deviance is within 3.84 of the minimum (95 %); open where it reaches a bound;
- value: the m that minimises deviance + ((ln m - ln 3.9) / 0.69)^2, a pseudo-observation of ln m whose 95 %
  interval is 1 to 15, the range of exponents reported for muscle and limbs. Where the data determine m, it
  has no influence; where they do not, it keeps m off a bound. No test and no verdict uses it.

Source: Venzon & Moolgavkar 1988, Appl Stat 37:87 (profile intervals); Sengeh et al. 2016, J Mech Behav
Biomed Mater 59:379 (m 4.7 in a residual limb); Oddes & Solav 2023 (m is hard to identify from indentation).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.model import Array

USUAL_M, LN_M_DEVIATION = 3.9, 0.69
PRIOR = f"ln m = ln {USUAL_M} with deviation {LN_M_DEVIATION} (m from 1 to 15, 95 %); values only, no test"
TISSUE = ("c_kpa", "m")
_PLACES, _REFINED = 10, 3
_BETWEEN = 25  # points between two evaluated m at which the profile is interpolated
_SAME = 1.001  # ratio of two m below which they count as one
_FAR = 20.0  # deviance above that at the fit's own m at which the profile ends


@dataclass(frozen=True, eq=False)
class Conditional:
    """The best fit at one fixed m: its deviance, all values, and the standard deviation of each at that m."""

    deviance: float
    values: Mapping[str, float]
    deviations: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Reported:
    """Reported parameter values and intervals of an explanation.

    values : with the weak prior; best : without it; intervals : 95 %, by name; open : "m below", "m above",
    "c below", "c above" where the interval reaches a bound; over : number of explanations that the intervals
    of c and m cover
    """

    values: Mapping[str, float]
    best: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    open: tuple[str, ...] = ()
    prior: str = ""
    over: int = 1

    def whichever(self, others: Sequence[Reported]) -> Reported:
        """Extend the intervals of c and m to cover those of other explanations, any of which may be true."""
        several = [self, *others]
        ends = dict(self.intervals)
        for name in TISSUE:
            known = [each.intervals[name] for each in several if name in each.intervals]
            if known:
                ends[name] = min(low for low, _ in known), max(high for _, high in known)
        is_open = tuple(dict.fromkeys(end for each in several for end in each.open))
        return replace(self, intervals=ends, open=is_open, over=len(several))

    def within(self, limits: Mapping[str, tuple[float, float]]) -> Reported:
        """Clip the intervals to the searched range `limits`; an end of c or m on its limit is marked open."""
        ends = dict(self.intervals)
        for name in ends.keys() & limits.keys():
            ends[name] = max(ends[name][0], limits[name][0]), min(ends[name][1], limits[name][1])
        is_open = dict.fromkeys(self.open)
        for name, letter in zip(TISSUE, ("c", "m"), strict=True):
            for k, side in enumerate(("below", "above")):
                if name in ends and name in limits and ends[name][k] == limits[name][k]:
                    is_open[f"{letter} {side}"] = None
        return replace(self, intervals=ends, open=tuple(is_open))

    def widened(self, times: float) -> Reported:
        """Move the ends of the intervals of c and m `times` as far from the value, on a log scale."""
        ends = dict(self.intervals)
        for name in ends.keys() & set(TISSUE):
            value, (low, high) = self.values[name], ends[name]
            ends[name] = min(low, value * (low / value) ** times), max(high, value * (high / value) ** times)
        return replace(self, intervals=ends)

    @property
    def is_pulled(self) -> bool:
        """Whether the prior moved ln m by more than `PULLED`."""
        if "m" not in self.values or "m" not in self.best:
            return False
        return abs(float(np.log(self.values["m"] / self.best["m"]))) > thresholds.PULLED


Walk = Callable[[float, Mapping[str, float]], Conditional]


def reported(
    walk: Walk, start: Mapping[str, float], bounds: tuple[float, float], *, scale: float
) -> Reported:
    """Compute the profile over m in both directions from the fit, and derive intervals and values from it.

    Parameters
    ----------
    walk : returns the best fit at an m, with a neighbour's values as initial guess
    scale : divisor of the deviance: chi2/nu where the noise level is unknown, else 1
    """
    profile = _walked(walk, start, bounds, far=_FAR * scale)
    penalised = {m: profile[m].deviance / scale + _penalty(m) for m in profile}
    chosen = _refined(walk, profile, penalised, scale)
    best = min(profile, key=lambda m: profile[m].deviance)
    limit = profile[best].deviance / scale + thresholds.WITHIN
    places = sorted(profile)
    low, high = _edges(places, np.array([profile[m].deviance / scale for m in places]))
    runs = [
        side for side, at, end in (("m below", low, bounds[0]), ("m above", high, bounds[1])) if at == end
    ]
    intervals = {"m": (low, high), **_others(profile, limit, scale)}
    return Reported(chosen, profile[best].values, intervals, tuple(runs), PRIOR)


def _penalty(m: float) -> float:
    return float((np.log(m / USUAL_M) / LN_M_DEVIATION) ** 2)


def _walked(
    walk: Walk, start: Mapping[str, float], bounds: tuple[float, float], *, far: float
) -> dict[float, Conditional]:
    """Evaluate the profile from the fit's m up and down to the bounds, starting each m from its neighbour."""
    own = float(np.clip(start["m"], *bounds))
    own = next((end for end in bounds if end / _SAME < own < end * _SAME), own)  # fits stop short of a bound
    grid = np.exp(np.linspace(np.log(bounds[0]), np.log(bounds[1]), _PLACES))
    grid[0], grid[-1] = bounds
    profile = {own: walk(own, start)}
    for places in (grid[grid > own * _SAME], grid[grid < own / _SAME][::-1]):
        values = profile[own].values
        for m in places.tolist():
            profile[m] = walk(m, values)
            values = profile[m].values
            if profile[m].deviance > profile[own].deviance + far:
                break
    return profile


def _refined(
    walk: Walk, profile: dict[float, Conditional], penalised: dict[float, float], scale: float
) -> Mapping[str, float]:
    """Refine the minimum of the penalised deviance by halving the step to its neighbours `_REFINED` times."""
    best = min(penalised, key=lambda m: penalised[m])
    places = sorted(penalised)
    at = places.index(best)
    near = [abs(np.log(places[k] / best)) for k in (at - 1, at + 1) if 0 <= k < len(places)]
    step = max(near, default=0.0)
    for _ in range(_REFINED):
        step /= 2
        for m in (best * np.exp(-step), best * np.exp(step)):
            if not places[0] <= m <= places[-1]:
                continue
            found = walk(float(m), profile[best].values)
            profile[float(m)], penalised[float(m)] = found, found.deviance / scale + _penalty(float(m))
        best = min(penalised, key=lambda m: penalised[m])
    return profile[best].values


def _edges(places: list[float], deviance: Array) -> tuple[float, float]:
    """Outermost m whose deviance is within `WITHIN` of the minimum.

    Between evaluated m, the square root of the excess deviance is interpolated linearly in ln m, which is
    exact where the deviance is a parabola in ln m.

    >>> x = np.array([-1.0, 0.0, 0.5])
    >>> [round(float(np.log(m)), 3) for m in _edges(np.exp(x).tolist(), 16.0 * x**2)]
    [-0.49, 0.49]
    """
    root, limit = np.sqrt(deviance - deviance.min()), thresholds.WITHIN**0.5
    inside = np.flatnonzero(root <= limit)
    x = np.log(places)

    def edge(k: int, neighbour: int) -> float:
        if not 0 <= neighbour < len(places):
            return places[k]
        share = (limit - root[k]) / (root[neighbour] - root[k])
        return float(np.exp(x[k] + share * (x[neighbour] - x[k])))

    first, last = int(inside[0]), int(inside[-1])
    return edge(first, first - 1), edge(last, last + 1)


def _others(
    profile: Mapping[float, Conditional], limit: float, scale: float
) -> dict[str, tuple[float, float]]:
    """Intervals of the other parameters: the union over all admissible m of the intervals at that m.

    At each m the interval uses the part of the deviance limit that m itself leaves. Between evaluated m, the
    square root of the excess deviance, the values and the standard deviations are interpolated linearly, as
    in `_edges`. c is treated in logarithms, which keeps it positive: its deviation is relative.
    """
    walked = [profile[m] for m in sorted(profile)]
    x = np.log(sorted(profile))
    at = np.unique(np.concatenate([x, *(np.linspace(a, b, _BETWEEN) for a, b in pairwise(x))]))
    deviance = np.array([each.deviance / scale for each in walked])
    root = np.interp(at, x, np.sqrt(deviance - deviance.min()))
    left = limit - deviance.min() - root**2
    inside = left >= 0
    reach = np.sqrt(left[inside] * scale)
    found = {}
    for name in walked[0].deviations:
        values, deviations = (
            np.array([each[name] for each in table])
            for table in ([c.values for c in walked], [c.deviations for c in walked])
        )
        values = np.log(values) if name == "c_kpa" else values
        value, further = (np.interp(at, x, each)[inside] for each in (values, deviations))
        ends = float(np.min(value - reach * further)), float(np.max(value + reach * further))
        if name == "c_kpa":
            with np.errstate(over="ignore"):  # infinite where c is open
                ends = float(np.exp(ends[0])), float(np.exp(ends[1]))
        found[name] = ends
    return found
