"""Whether a fit meets its data: the misfit against what the stated noise explains, and R2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.inference.statistics import root_mean_square
from limbcli.model import Array
from limbcli.significant_digits import short

BEYOND_NOISE = 2.0  # times the stated noise; with six residuals chance alone gives 1.5 in one of forty
LEAST_R2 = 0.9  # any curve that rises with the force has more


@dataclass(frozen=True)
class Misfit:
    """rmse, noise : root mean square of the loaded levels' residuals and of what their noise explains, N; r2
    may be NaN."""

    rmse: float
    noise: float
    r2: float

    @property
    def times_noise(self) -> float:
        """NaN where no noise is stated."""
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
    """residual, variance of it : N, N^2, (n,) of the loaded levels; at first touch the probe misses nothing

    >>> misfit(np.array([0.3, -0.3]), np.array([0.01, 0.09]), 0.99).times_noise
    1.3416407864998738
    """
    noise = float(np.sqrt(np.mean(variance))) if len(variance) else 0.0
    return Misfit(root_mean_square(residual) if len(residual) else 0.0, noise, r2)
