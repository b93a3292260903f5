"""Evidence of an explanation: its likelihood, integrated over its parameters about the fit.

Laplace's approximation with the sensitivities that the fit has: the integrand is normal in the parameters,
truncated at their limits, so that a size that ends at its null value, or on a bound, is integrated on one
side only. Errors of the model of unknown size (`Scalable`) are set to the size that makes the evidence
largest, in every explanation anew.

Source: MacKay 2003, Information Theory, Inference, and Learning Algorithms, chapters 27 and 28.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr, ndtr

from limbcli.diagnosis.explanations.forward_model import Fitted, Scalable
from limbcli.diagnosis.explanations.noise import Noise
from limbcli.model import Array
from limbcli.numbers.whitening import Whitener

_FAR = 8.0  # standard deviations beyond which a limit does not matter
_GRID = 2001  # points of a numerical quantile
_STEP, _MOST_STEPS = 0.3, 12  # of ln of a share or level, in the search for the most probable one
_KINK = 1.0  # gain in ln likelihood by a further linear step, from which the fit is taken as it stands
_MOST_LEVEL = 10.0  # largest factor on stated noise of unknown level, and reciprocal of the least


def ln_probability(mean: Array, covariance: Array, low: Array, high: Array) -> Array:
    """ln of the probability of the box, (n,), for each of the means (n, p).

    One limit after the other, with mean and variance of the truncated distribution carried on; exact in one
    dimension and for independent ones.

    Source: Mendell & Elston 1974, Biometrics 30:41.

    >>> round(float(ln_probability(np.zeros((1, 1)), np.eye(1), np.zeros(1), np.full(1, np.inf))[0]), 4)
    -0.6931
    """
    mean, covariance = np.array(mean, dtype=float), np.array(covariance, dtype=float)
    total = np.zeros(len(mean))
    for k in range(mean.shape[1]):
        deviation = np.sqrt(max(covariance[k, k], 1e-300))
        if np.all(low[k] - mean[:, k] < -_FAR * deviation) and np.all(
            high[k] - mean[:, k] > _FAR * deviation
        ):
            continue
        a, b = (low[k] - mean[:, k]) / deviation, (high[k] - mean[:, k]) / deviation
        ln_p = _ln_between(a, b)
        total += ln_p
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            at_a, at_b = (
                np.where(np.isfinite(x), np.exp(-0.5 * x**2 - ln_p) / np.sqrt(2 * np.pi), 0.0) for x in (a, b)
            )
            first = at_a - at_b
            lost = first**2 - np.nan_to_num(a * at_a) + np.nan_to_num(b * at_b)
        onto = covariance[:, k] / deviation
        later = slice(k + 1, None)
        mean[:, later] += first[:, None] * onto[later]
        # one covariance for all: that of the mean loss, exact for a single mean
        covariance[later, later] -= float(np.clip(np.mean(lost), 0.0, 1.0)) * np.outer(
            onto[later], onto[later]
        )
    return total


def _ln_between(a: Array, b: Array) -> Array:
    """ln(Phi(b) - Phi(a)), accurate in either tail."""
    flip = a + b > 0
    low, high = np.where(flip, -b, a), np.where(flip, -a, b)
    upper, lower = log_ndtr(high), log_ndtr(low)
    return upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-12)))


@dataclass(frozen=True)
class Truncated:
    """A normal distribution between two limits, with a weight."""

    weight: float
    mean: float
    deviation: float
    low: float = -np.inf
    high: float = np.inf


def quantiles(several: Sequence[Truncated], shares: Sequence[float]) -> list[float]:
    """Quantiles of a mixture.

    >>> [round(x, 2) for x in quantiles([Truncated(1.0, 1.0, 1.0)], (0.025, 0.5))]
    [-0.96, 1.0]
    """
    x, total = _distribution(several)
    return [float(np.interp(share, total, x)) for share in shares]


def shortest(several: Sequence[Truncated], share: float) -> tuple[float, float]:
    """The shortest interval of a mixture with this probability: it begins at a limit that is most probable.

    >>> low, high = shortest([Truncated(1.0, -1.0, 1.0, low=0.0)], 0.95)
    >>> low, round(high, 2)
    (0.0, 1.41)
    """
    x, total = _distribution(several)
    below = np.linspace(0.0, 1.0 - share, _GRID)
    low, high = np.interp(below, total, x), np.interp(below + share, total, x)
    low[0], high[-1] = (
        x[max(int(np.searchsorted(total, 0.0, side="right")) - 1, 0)],
        x[np.searchsorted(total, 1.0)],
    )
    best = int(np.argmin(high - low))
    return float(low[best]), float(high[best])


def _distribution(several: Sequence[Truncated]) -> tuple[Array, Array]:
    """Values, and the probability of what is below them."""
    ends = [
        (max(each.low, min(each.mean, each.high) - _FAR * each.deviation),
         min(each.high, max(each.mean, each.low) + _FAR * each.deviation)) for each in several
    ]  # fmt: skip
    # finely where each of them is narrow
    x = np.unique(np.concatenate([np.linspace(low, high, _GRID) for low, high in ends]))
    total = np.zeros(len(x))
    for each in several:
        a, b, at = ((end - each.mean) / each.deviation for end in (each.low, each.high, x))
        inside = np.clip(at, a, b)
        if a > 0:  # of the small numbers, not their differences from 1
            share = (ndtr(-a) - ndtr(-inside)) / max(ndtr(-a) - ndtr(-b), 1e-300)
        else:
            share = (ndtr(inside) - ndtr(a)) / max(ndtr(b) - ndtr(a), 1e-300)
        total += each.weight * share
    return x, total / max(total[-1], 1e-300)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Evidence of one explanation, but for a constant of the data, and its parameters' distribution about the
    fit.

    step, covariance : (p,), (p, p) mean less the fitted values, and covariance, both without the limits
    chi2 : of the residual at the fit; shares : of the scalable errors; level : factor on all noise
    """

    fitted: Fitted
    ln_evidence: float
    step: Array
    covariance: Array
    chi2: float
    shares: Mapping[str, float]
    level: float = 1.0

    def noise(self, stated: Noise) -> Noise:
        """The stated noise with the model's errors as large as they are in this explanation."""
        for name, share in self.shares.items():
            stated = stated.with_share(name, share)
        return stated.amplified(self.fitted.amplification)

    @cached_property
    def deviation(self) -> Array:
        """(p,)"""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


def posterior(
    fitted: Fitted, y: Array, noise: Noise, scalable: Sequence[Scalable] = (), *, form: Array | None = None,
    relative: bool = False,
) -> Posterior:  # fmt: skip
    """The posterior of a fit to the data y (n,); form (n, n) : covariance of the error of the effects' own
    form; relative : the level of the noise is unknown"""
    noise = noise.amplified(fitted.amplification)
    known = {each.name: each for each in scalable if each.name in noise.names}
    scaled = {part.name: part.covariance for part in noise.parts if part.name in known}
    fixed = np.asarray(sum(part.covariance for part in noise.parts if part.name not in known))
    fixed = fixed if form is None else fixed + form

    def at(shares: Mapping[str, float]) -> Posterior:
        total = fixed.copy()
        for name, share in shares.items():
            total += share**2 * scaled[name]
        whiten = Whitener.of(total)
        r, J = whiten(y - fitted.prediction), whiten(fitted.jacobian)
        ln_root = float(np.log(np.diag(whiten.factor)).sum())

        def at_level(ln_level: float) -> Posterior:
            level = math.exp(ln_level)
            return gaussian(fitted, r / level, J / level, ln_root + len(r) * ln_level, shares, level)

        as_stated, most = at_level(0.0), math.log(_MOST_LEVEL)
        return _largest(at_level, as_stated, -most, most) if relative else as_stated

    best = at(dict.fromkeys(known, 1.0))
    for name, each in known.items():
        others = dict(best.shares)

        def along(ln_share: float, name: str = name, others: dict[str, float] = others) -> Posterior:
            return at({**others, name: math.exp(ln_share)})

        best = _largest(along, best, math.log(each.least), math.log(each.most))
    return best


def _largest(along: Callable[[float], Posterior], first: Posterior, low: float, high: float) -> Posterior:
    """The posterior with the largest evidence between two values of one unknown, from the known one at 0, by
    steps while the evidence rises, then the summit of the parabola through the best three."""
    found = {0.0: first}

    def value(x: float) -> float:
        if x not in found:
            found[x] = along(x)
        return found[x].ln_evidence

    at, step = 0.0, _STEP
    for _ in range(_MOST_STEPS):
        sides = [min(max(x, low), high) for x in (at - step, at + step)]
        best = max((at, *sides), key=value)
        if best == at:
            break
        at = best
    left, right = (min(max(x, low), high) for x in (at - step, at + step))
    if left < at < right:
        rise, fall = (value(at) - value(left)) / (at - left), (value(at) - value(right)) / (right - at)
        if rise + fall > 0:
            value(min(max(at + 0.5 * step * (rise - fall) / (rise + fall), low), high))
    return max(found.values(), key=lambda each: each.ln_evidence)


def gaussian(
    fitted: Fitted, r: Array, J: Array, ln_root: float, shares: Mapping[str, float], level: float
) -> Posterior:
    """The posterior from whitened residual r (n,) and sensitivities J (n, p); ln_root : ln det Sigma / 2"""
    priors = fitted.priors
    A = J.T @ J + np.diag(priors.precision)
    pull = J.T @ r + priors.precision * priors.shift
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    inverse = scale[:, None] * np.linalg.inv(A * np.outer(scale, scale)) * scale
    inside = (priors.low < -1e-9) & (priors.high > 1e-9)
    if inside.any():  # a fit that a kink of the model stopped is judged where it stands
        free = np.linalg.pinv(A[np.ix_(inside, inside)])
        if 0.5 * float(pull[inside] @ free @ pull[inside]) > _KINK:
            pull = np.where(inside, 0.0, pull)
    step = inverse @ pull
    ln_prior = 0.5 * np.log(np.maximum(priors.precision, 1e-300)).sum()
    ln_prior -= 0.5 * float(priors.precision @ priors.shift**2)
    _, ln_det = np.linalg.slogdet(A * np.outer(scale, scale))
    ln_det -= 2 * np.log(scale).sum()
    ln = -0.5 * float(r @ r) + 0.5 * float(pull @ step) - 0.5 * ln_det + ln_prior - ln_root
    ln += float(ln_probability(step[None], inverse, priors.low, priors.high)[0])
    # of the prior in the box, which the normal ones are divided by; that of uniform ones is 1
    n = priors.is_normal
    prior = priors.shift[None, n], np.diag(1 / priors.precision[n]), priors.low[n], priors.high[n]
    ln -= float(ln_probability(*prior)[0])
    return Posterior(
        fitted, ln_evidence=ln + fitted.ln_points, step=step, covariance=inverse, chi2=float(r @ r),
        shares=dict(shares), level=level,
    )  # fmt: skip
