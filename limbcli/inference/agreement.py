"""Whether a fit agrees with its data: good, doubtful or bad, by tests whose numbers the verdict states.

The only place that decides this: the fits write its answer to their results, and the terminal, the page, the
index of several subjects and `--json` show it.

Three tests per quantity. Chi-square: the chance that data with the counted noise differ from the model by at
least as much (and, on the other side, by at most as little). Size: root mean square of the differences over
that of the counted noise, and R2. Runs: the chance of so few changes of sign along the depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.special import bdtr, chdtr, chdtrc

from limbcli.inference.prediction import root_mean_square
from limbcli.model import Array
from limbcli.numbers.significant_digits import short

State = Literal["good", "doubtful", "bad", "untested"]
ORDER: tuple[State, ...] = ("good", "untested", "doubtful", "bad")  # the worst decides for a whole

BAD_CHANCE = 0.005
DOUBTFUL_CHANCE = 0.05
TOO_CLOSE_CHANCE = 0.01
# Ratio of RMSE to counted noise above which a fit is bad; with six residuals chance alone exceeds 1.5 in one
# case of forty. Below the other, the order of signs says nothing.
BEYOND_NOISE, WITHIN_NOISE = 2.0, 0.5
LEAST_POISSON = 0.4  # Poisson's ratio below which a tissue is none
LEAST_R2 = 0.9  # R2 below which a fit is bad; any curve that increases with the force has more


@dataclass(frozen=True)
class FitAgreement:
    """A verdict with its numbers, None where there is none, and one sentence with those that decided.

    rms, noise_rms : of the differences and of the counted noise, in the unit of the quantity
    chance, chance_below : probability of a chi-square as large or larger, and as small or smaller
    n_changes, runs_chance : changes of sign along the depth, and the probability of as few
    too_close : whether the differences are smaller than the counted noise allows
    """

    state: State
    words: str
    rms: float | None = None
    noise_rms: float | None = None
    chi_square_per_freedom: float | None = None
    n_freedom: int | None = None
    chance: float | None = None
    chance_below: float | None = None
    n_changes: int | None = None
    runs_chance: float | None = None
    too_close: bool = False

    @property
    def times_noise(self) -> float:
        """RMS divided by the counted noise; NaN if none is counted."""
        return self.rms / self.noise_rms if self.rms is not None and self.noise_rms else float("nan")


def force_agreement(
    residual: Array, deviation: Array, r2: float, *, n_free: int, likelihood: tuple[float, int] | None = None
) -> FitAgreement:
    """FitAgreement of a force curve with the loaded levels.

    residual, deviation : (n,) N, in order of depth; the standard deviation that the fit counted at each
        level. First touch is excluded, because there the residual is 0.
    r2 : coefficient of determination; may be NaN
    n_free : number of parameters that were searched
    likelihood : chi-square and degrees of freedom of the most likely curve, which also counts the errors of c
        and mesh; None: those of this curve and its noise alone

    >>> force_agreement(np.array([2.0, -2.0, 2.0]), np.full(3, 0.5), 0.99, n_free=2).words
    'it differs from the measured force by 2 N (RMSE under load), 4 times the counted noise of 0.5 N'
    >>> force_agreement(np.full(5, 0.3) * [1, -1, 1, 1, -1], np.full(5, 0.3), 0.99, n_free=2).state
    'good'
    """
    residual, deviation = np.asarray(residual, dtype=float), np.asarray(deviation, dtype=float)
    if not len(residual):
        return FitAgreement("untested", "the force cannot be compared: there is no loaded level")
    rms, noise = root_mean_square(residual), root_mean_square(deviation)
    told = f"it differs from the measured force by {short(rms, 2)} N (RMSE under load)"
    poor = bool(np.isfinite(r2) and r2 < LEAST_R2)
    seen = f"; R2 {r2:.2f}" if poor else ""
    if not (deviation > 0).all():
        if poor:
            return FitAgreement("bad", f"{told}{seen}", rms, noise or None)
        return FitAgreement(
            "untested",
            "not tested: no noise of force or depth is stated with which to compare the RMSE of "
            f"{short(rms, 2)} N",
            rms,
        )
    own, n_own = float(np.sum((residual / deviation) ** 2)), len(residual) - n_free
    chi_square, n_freedom = likelihood or (own, n_own)
    numbers = _numbers(rms, noise, chi_square, n_freedom, below=(own, n_own), signs=residual)
    of_noise = f"{short(rms / noise, 2)} times the counted noise of {short(noise, 2)} N"
    return _judged(
        numbers, bad=rms > BEYOND_NOISE * noise or poor,
        good=f"the force {{agrees}}: RMSE {short(rms, 2)} N under load, {of_noise}",
        poor=f"{told}, {of_noise}{seen}",
    )  # fmt: skip


def speed_agreement(
    predicted: Array, measured: Array, *, level_fraction: float, c_deviation: float
) -> FitAgreement:
    """FitAgreement of predicted mean shear-wave speeds with those measured under load.

    predicted, measured : (n,) m/s, in order of depth; NaN where not measured
    level_fraction : standard deviation of one level's mean speed, as a fraction of it
    c_deviation : standard deviation of ln c; it moves all predictions together, by half of it

    >>> speed_agreement(np.array([2.28]), np.array([2.95]), level_fraction=0.05, c_deviation=0.1).words
    'the predicted shear-wave speed at the last level is 2.28 m/s, measured 2.95 m/s (23 % too slow); \
chi2/nu 12.9, chance 0.033 %'
    """
    known = np.isfinite(measured) & np.isfinite(predicted)
    predicted, measured = np.asarray(predicted)[known], np.asarray(measured)[known]
    if not len(measured):
        return FitAgreement(
            "untested", "the predicted shear-wave speeds are not tested: none was measured under load"
        )
    gap = predicted - measured
    off = 100 * abs(gap[-1]) / measured[-1]
    by = f"{off:.0f} % too {'fast' if gap[-1] > 0 else 'slow'}" if off >= 0.5 else "less than 1 % off"
    told = (
        f"the predicted shear-wave speed at the last level is {predicted[-1]:.2f} m/s, measured "
        f"{measured[-1]:.2f} m/s ({by})"
    )
    if not level_fraction > 0:
        return FitAgreement(
            "untested", f"{told}; not tested: no noise of the speeds is stated", root_mean_square(gap)
        )
    own, common = level_fraction * measured, 0.5 * c_deviation * predicted
    covariance = np.diag(own**2) + np.outer(common, common)
    chi_square = float(gap @ np.linalg.solve(covariance, gap))
    noise = root_mean_square(np.sqrt(np.diag(covariance)))
    # speeds of one image series share their errors: too close, and runs of one sign, say nothing
    numbers = _numbers(root_mean_square(gap), noise, chi_square, len(gap))
    return _judged(numbers, bad=False, good=told, poor=told)


def tissue_agreement(f_kappa_below: float | None, at_lower_bound: Sequence[str]) -> FitAgreement | None:
    """What speaks against a fit with parameters of no soft tissue, however well it agrees; None if nothing.

    f_kappa_below : its upper 95 % limit, None if open. With kappa' = f_kappa c the ratio of bulk to shear
    modulus is 2 f_kappa + 2/3, which gives Poisson's ratio; that of soft tissue is 0.45 to 0.5.
    at_lower_bound : names of the parameters that ended there

    >>> tissue_agreement(20.0, []) is None
    True
    >>> tissue_agreement(1.95, ["f_kappa"]).state, tissue_agreement(9.0, ["m"]).state
    ('bad', 'doubtful')
    """
    ratio = 2.0 * (np.inf if f_kappa_below is None else f_kappa_below) + 2.0 / 3.0
    poisson = (3.0 - 2.0 / ratio) / (6.0 + 2.0 / ratio)
    if poisson < LEAST_POISSON:
        return FitAgreement(
            "bad",
            "the forces are too low for the shear-wave speed at rest: only tissue with f_kappa below "
            f"{short(f_kappa_below or 0.0)} gives them (Poisson's ratio below {poisson:.2f}; soft tissue has "
            "0.45 to 0.5). Is force_n in another unit (lbf: multiply by 4.448), or the speed that of a stiff "
            "layer?",
        )
    if at_lower_bound:
        return FitAgreement(
            "doubtful",
            f"{' and '.join(at_lower_bound)} ended on the lower bound: the force grows with the depth more "
            "slowly than that of soft tissue with this speed. Check depth_mm (unit, first touch), force_n "
            "(unit, tare), and whether the images end close to the probe",
        )
    return None


def chi_square_agreement(chi_square: float, n_freedom: int) -> FitAgreement:
    """FitAgreement of a fit of several channels together, of which only chi-square is known.

    >>> chi_square_agreement(30.0, 3).words
    'the fit does not reproduce the data; chi2/nu 10, chance 0.00014 %'
    >>> chi_square_agreement(12.0, 10).state, chi_square_agreement(0.1, 10).state
    ('good', 'doubtful')
    """
    numbers = _numbers(None, None, chi_square, n_freedom, below=(chi_square, n_freedom))
    return _judged(
        numbers, bad=False, good="the fit {agrees} with the data", poor="the fit does not reproduce the data"
    )


def _numbers(
    rms: float | None, noise: float | None, chi_square: float, n_freedom: int, *,
    below: tuple[float, int] | None = None, signs: Array | None = None,
) -> Mapping[str, Any]:  # fmt: skip
    """The numbers of an `FitAgreement`; a test without degrees of freedom has none."""
    found: dict[str, Any] = {"rms": rms, "noise_rms": noise, "n_freedom": n_freedom}
    if n_freedom > 0:
        found["chi_square_per_freedom"] = chi_square / n_freedom
        found["chance"] = float(chdtrc(n_freedom, chi_square))
    if below is not None and below[1] > 0:
        found["chance_below"] = float(chdtr(below[1], below[0]))
    if signs is not None and len(signs) > 1:
        changes = int(np.count_nonzero(np.diff(np.sign(signs))))
        found["n_changes"], found["runs_chance"] = changes, float(bdtr(changes, len(signs) - 1, 0.5))
    return found


def _judged(numbers: Mapping[str, Any], *, bad: bool, good: str, poor: str) -> FitAgreement:
    """The verdict of the tests; bad : a test of size has decided; good : words, with the field `agrees`"""
    chance, below, runs = (numbers.get(name) for name in ("chance", "chance_below", "runs_chance"))
    told = ""
    if chance is not None:
        share = f"{short(100 * chance, 2)} %" if chance > 1e-6 else "below 0.0001 %"
        told = f"; chi2/nu {short(numbers['chi_square_per_freedom'], 3)}, chance {share}"
    if bad:
        return FitAgreement("bad", poor, **numbers)
    if chance is not None and chance < BAD_CHANCE:
        return FitAgreement("bad", f"{poor}{told}", **numbers)
    if chance is not None and chance < DOUBTFUL_CHANCE:
        return FitAgreement("doubtful", f"{good.format(agrees='agrees poorly')}{told}", **numbers)
    if below is not None and below < TOO_CLOSE_CHANCE:
        close = (
            f"{good.format(agrees='agrees too well')}; chi2/nu "
            f"{short(numbers['chi_square_per_freedom'], 3)}. This is closer than the counted "
            f"noise allows (a misfit as small has a chance of {short(100 * below, 2)} %): the stated noise "
            "is too large, or the levels were smoothed"
        )
        return FitAgreement("doubtful", close, **numbers, too_close=True)
    good = good.format(agrees="agrees")
    rms, noise = numbers.get("rms"), numbers.get("noise_rms")
    visible = rms is not None and noise is not None and rms > WITHIN_NOISE * noise
    if runs is not None and runs < DOUBTFUL_CHANCE and visible:
        drift = (
            f"{good}{told}. The differences change sign only {_times(numbers['n_changes'])} along the depth "
            f"(chance {short(100 * runs, 2)} %): the curve's shape is not that of the levels"
        )
        return FitAgreement("doubtful", drift, **numbers)
    if chance is None:
        return FitAgreement("untested", f"{good}; not tested: as many parameters as levels", **numbers)
    return FitAgreement("good", f"{good}{told}", **numbers)


def _times(n: int) -> str:
    return "once" if n == 1 else f"{n} times"
