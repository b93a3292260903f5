"""Leave one site out, predict its reading from the others: is it inside its interval as often as said?"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats import binom

from limbcli.stiffness_field.field import HypothesisGrid, StiffnessField, quantile, without_site
from limbcli.stiffness_field.likelihood import Known, likelihood_of

_AT_ODDS_Z = 2.58  # two sites of one place at odds: p 0.01
_TOGETHER = 0.9  # correlation of the regions of two sites above which they are one place


@dataclass(frozen=True)
class HeldOut:
    """A site's c, predicted from all other sites.

    c, low, high : MPa, as the site reads it; predicted, predicted_low, predicted_high : MPa, the 95 %
        interval in which its reading was expected, its own error included
    z : distance of the reading from the prediction, in standard deviations of a normal distribution
    inside : whether the reading is in the interval
    """

    site: str
    c: float
    low: float
    high: float
    predicted: float
    predicted_low: float
    predicted_high: float
    z: float
    inside: bool


@dataclass(frozen=True)
class HeldOutTest:
    """All sites, each left out in turn, and the sites that could not be tested with the reason.

    p : probability of at most so many inside, if each were inside with 95 %
    """

    sites: tuple[HeldOut, ...]
    skipped: dict[str, str]

    @property
    def n_inside(self) -> int:
        return sum(each.inside for each in self.sites)

    @property
    def p(self) -> float:
        return float(binom.cdf(self.n_inside, len(self.sites), 0.95))

    @property
    def words(self) -> str:
        if not self.sites:
            return "no site could be left out and predicted: it takes two with c"
        out = [each.site for each in self.sites if not each.inside]
        words = f"{self.n_inside} of {len(self.sites)} sites are inside the 95 % interval predicted without"
        return f"{words} them" + (f"; outside: {', '.join(out)}" if out else "")


def held_out(field: StiffnessField, grid: HypothesisGrid | None = None) -> HeldOutTest:
    """Predict the c of every site from the others.

    A site whose c is only bounded, or which has only a map, is skipped with the reason.
    """
    found, skipped = [], {}
    for site in field.sites:
        c = site.values.get("c")
        known = likelihood_of(c, where=f"c of site {site.name}") if c is not None else None
        if c is None or not isinstance(known, Known):
            skipped[site.name] = "its c has no interval with two ends"
            continue
        others = without_site(field, site.name, grid)
        if not len(others.known):
            skipped[site.name] = "no other site has c"
            continue
        mean, variance = others.mean_over("c", site.points)
        own = np.array([part.hypotheses[0].own_error ** 2 for part in others.parts])
        # The reading lies above what is predicted by its upper error, below it by its lower one.
        ends, shares = [], others.shares
        for q, deviation in ((0.025, known.above), (0.5, 0.0), (0.975, known.below)):
            total = (variance + own + deviation**2)[:, None]
            ends.append(float(quantile(q, mean[:, None], total, shares)[0]))
        side = known.above if known.mode < ends[1] else known.below
        below = float(shares @ ndtr((known.mode - mean) / np.sqrt(variance + own + side**2)))
        low, middle, high = np.exp(ends).tolist()
        found.append(
            HeldOut(
                site.name, float(np.exp(known.mode)), float(c.low or 0), float(c.high or np.inf), middle, low,
                high, float(ndtri(np.clip(below, 1e-12, 1 - 1e-12))), ends[0] <= known.mode <= ends[2],
            )
        )  # fmt: skip
    return HeldOutTest(tuple(found), skipped)


def contradictions(field: StiffnessField) -> list[str]:
    """Sentences on pairs of sites at one place whose c differ by more than their intervals allow (p 0.01)."""
    from limbcli.stiffness_field.kernel import correlation

    lengths = max(field.hypotheses("c"), key=lambda each: each[1])[0].lengths
    found = []
    known = []
    for site in field.sites:
        c = site.values.get("c")
        likelihood = likelihood_of(c, where=f"c of site {site.name}") if c is not None else None
        if isinstance(likelihood, Known):
            known.append((site, likelihood, field.limb.places(site.points)))
    for (one, a, at), (other, b, beside) in itertools.combinations(known, 2):
        own = np.sqrt(correlation(at, at, lengths).mean() * correlation(beside, beside, lengths).mean())
        if correlation(at, beside, lengths).mean() < _TOGETHER * own:
            continue
        high, low = (a, b) if a.mode > b.mode else (b, a)
        z = (high.mode - low.mode) / np.linalg.norm([high.below, low.above])
        if z > _AT_ODDS_Z:
            found.append(
                f"{one.name} and {other.name} lie at one place, and their c differ by a factor of "
                f"{np.exp(abs(a.mode - b.mode)):.2g}, {z:.1f} standard deviations of their intervals"
            )
    return found
