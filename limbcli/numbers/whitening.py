"""Whitening of residuals, which become independent and of variance 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from scipy.linalg.lapack import dtrtrs

from limbcli.errors import FitError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Whitener:
    """Cholesky factor L of Sigma = L L': `whiten(x)` is L^-1 x, for x (n,) or (n, k)."""

    factor: Array

    @staticmethod
    def of(covariance: Array) -> Whitener:
        """
        Raises FitError if the covariance is not positive definite.
        """
        try:
            return Whitener(np.asfortranarray(cholesky(covariance, lower=True)))
        except np.linalg.LinAlgError as error:
            raise FitError(
                "the noise of the data is not a positive definite covariance",
                where="noise model",
                fix="give every channel a standard deviation above zero in [site.noise]",
            ) from error

    def __call__(self, x: Array) -> Array:
        """
        Raises ValueError if x is not finite.
        """
        # LAPACK is called directly: for few data, scipy's checks take ten times as long as the solve
        found, _ = dtrtrs(self.factor, np.asarray_chkfinite(x), lower=1)
        return np.asarray(found)
