"""What a 95 % interval says about the logarithm of a parameter: two half normals, or a bound.

    value with both ends   two half normals about ln value that reach 1.96 deviations at ln low and ln high
    one end open           a bound: nothing but that values beyond the closed end are excluded

The likelihood of a bound rises from 0 to 1 and has fallen by 3.84 in deviance at the end of the interval, as
in a profile likelihood; how fast it falls beyond, ln 1.2, is chosen.

`moments` gives the first moments of a normal distribution times such a likelihood in closed form, for
expectation propagation.

Source: Rasmussen and Williams 2006, eqs. 3.82 to 3.85 (probit moments).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.special import log_ndtr

from limbcli.errors import FitError

REACH = 1.959964  # half width of a 95 % interval, in standard deviations
_SHIFT = -1.0496  # where the normal distribution function is exp(-3.84 / 2)
_SOFTNESS = 0.18  # ln 1.2, width of a bound's fall
_LEAST = 1e-3  # smallest standard deviation of a logarithm
_LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


@dataclass(frozen=True)
class Interval:
    """A parameter's value and the ends of its 95 % interval, in its unit; None: open on that side."""

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Known:
    """ln of a parameter: mode, and the standard deviation of the half normal below and above it."""

    mode: float
    below: float
    above: float

    @property
    def is_normal(self) -> bool:
        return abs(self.below - self.above) < 0.02 * self.below

    @property
    def variance(self) -> float:
        return 0.5 * (self.below**2 + self.above**2)

    def moments(self, mean: float, variance: float) -> tuple[float, float, float]:
        """ln of the integral of N(mean, variance) times the likelihood, and mean and variance of the
        product."""
        parts = [self._half(mean, variance, self.below, -1.0), self._half(mean, variance, self.above, 1.0)]
        top = max(each[0] for each in parts)
        shares = [math.exp(each[0] - top) for each in parts]
        total = sum(shares)
        first = sum(s * each[1] for s, each in zip(shares, parts, strict=True)) / total
        second = sum(s * (each[2] + (each[1] - first) ** 2) for s, each in zip(shares, parts, strict=True))
        return top + math.log(total), first, second / total

    def _half(
        self, mean: float, variance: float, deviation: float, side: float
    ) -> tuple[float, float, float]:
        """The same for one half: side -1 below the mode, 1 above."""
        own = deviation**2
        narrow = 1.0 / (1.0 / variance + 1.0 / own)
        middle = narrow * (mean / variance + self.mode / own)
        root = math.sqrt(narrow)
        reach = side * (middle - self.mode) / root
        inside = float(log_ndtr(reach))
        log_size = -0.5 * (mean - self.mode) ** 2 / (variance + own) + 0.5 * math.log(own / (own + variance))
        hazard = math.exp(-0.5 * reach * reach - _LOG_ROOT_2PI - inside)
        spread = narrow * max(1.0 - hazard * (reach + hazard), 1e-9)
        return log_size + inside, middle + side * root * hazard, spread


@dataclass(frozen=True)
class Bound:
    """ln of a parameter lies above (side 1) or below (side -1) `at`, at 97.5 %."""

    at: float
    side: float

    def moments(self, mean: float, variance: float) -> tuple[float, float, float]:
        """As of `Known`."""
        width = math.sqrt(_SOFTNESS**2 + variance)
        z = (self.side * (mean - self.at) + _SHIFT * _SOFTNESS) / width
        inside = float(log_ndtr(z))
        hazard = math.exp(-0.5 * z * z - _LOG_ROOT_2PI - inside)
        first = mean + self.side * variance * hazard / width
        second = variance - variance**2 * hazard * (z + hazard) / width**2
        return inside, first, max(second, 1e-12)


def likelihood_of(interval: Interval, *, where: str) -> Known | Bound | None:
    """The likelihood of ln of a parameter; None if its interval is open on both sides.

    A value outside its interval is replaced by the interval's middle (of logarithms).

    Raises FitError if a number is not finite and positive, or the interval's ends are reversed.

    >>> likelihood_of(Interval(3.0, 2.0, None), where="m of p1").side
    1.0
    """
    value, low, high = interval.value, interval.low, interval.high
    for name, each in (("value", value), ("low end", low), ("high end", high)):
        if each is not None and not (math.isfinite(each) and each > 0):
            raise FitError(
                f"the {name} of a site's reading is {each}, not a positive number",
                where=where,
                fix="fit the site again (`limbcli fit CASE`), or leave it out",
            )
    if low is None and high is None:
        return None
    if low is None or high is None:
        return Bound(math.log(low), 1.0) if low is not None else Bound(math.log(float(high or 0)), -1.0)
    if low > high:
        raise FitError(
            f"the 95 % interval of a site's reading runs from {low:g} down to {high:g}",
            where=where,
            fix="fit the site again (`limbcli fit CASE`), or leave it out",
        )
    a, b = math.log(low), math.log(high)
    mode = math.log(value) if low < value < high else 0.5 * (a + b)
    least = max(_LEAST, 0.05 * (b - a) / REACH)
    return Known(mode, max((mode - a) / REACH, least), max((b - mode) / REACH, least))
