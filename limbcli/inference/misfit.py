"""Whether a fit agrees with its data: the misfit compared with the stated noise, and R2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.inference.statistics import root_mean_square
from limbcli.model import Array
from limbcli.significant_digits import short

# Ratio of RMSE to stated noise above which a fit is poor; with six residuals chance alone exceeds 1.5 in one
# case of forty.
BEYOND_NOISE = 2.0
LEAST_R2 = 0.9  # R2 below which a fit is poor; any curve that increases with the force has more


@dataclass(frozen=True)
class Misfit:
    """Misfit of a force fit.

    rmse : root mean square of the residuals at the loaded levels (N)
    noise : root mean square expected from the stated noise (N)
    r2 : coefficient of determination; may be NaN
    """

    rmse: float
    noise: float
    r2: float

    @property
    def times_noise(self) -> float:
        """RMSE divided by the expected noise; NaN if no noise is stated."""
        return self.rmse / self.noise if self.noise > 0 else float("nan")

    @property
    def poor(self) -> bool:
        return bool(self.times_noise > BEYOND_NOISE or self.r2 < LEAST_R2)

    @property
    def words(self) -> str:
        """
        >>> Misfit(2.0, 0.5, float("nan")).words.removeprefix("poor fit: it differs from the measured ")
        'force by 2 N (RMSE under load), 4 times what the noise explains'
        >>> Misfit(0.5, 0.5, 0.8).words.removeprefix("poor fit: it differs from the measured force by ")
        '0.5 N (RMSE under load), 1 times what the noise explains; R2 0.80'
        >>> Misfit(0.5, 0.5, 0.99).words
        ''
        """
        if not self.poor:
            return ""
        text = f"poor fit: it differs from the measured force by {short(self.rmse, 2)} N (RMSE under load)"
        if np.isfinite(self.times_noise):
            text += f", {short(self.times_noise, 2)} times what the noise explains"
        return text + (f"; R2 {self.r2:.2f}" if np.isfinite(self.r2) else "")


def misfit(residual: Array, variance: Array, r2: float) -> Misfit:
    """Misfit of a fit from its residuals.

    residual, variance : (n,) at the loaded levels (N) and their variance (N^2); first touch is excluded,
        because there the residual is 0

    >>> misfit(np.array([0.3, -0.3]), np.array([0.01, 0.09]), 0.99).times_noise
    1.3416407864998738
    """
    noise = float(np.sqrt(np.mean(variance))) if len(variance) else 0.0
    return Misfit(root_mean_square(residual) if len(residual) else 0.0, noise, r2)
