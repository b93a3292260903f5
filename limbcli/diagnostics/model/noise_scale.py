"""Estimate the size of an assumed error from the data."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize_scalar

from limbcli.diagnostics.model.noise import Noise
from limbcli.model import Array

_EXACT = 0.01  # tolerance of ln share in the minimisation


def likeliest_share(residual: Array, jacobian: Array, noise: Noise, name: str, *, least: float) -> float:
    """Maximum-likelihood factor on the standard deviation of the noise part `name`, between `least` and 1.

    residual (n,) of a fit with sensitivities jacobian (n, p). An effect missing from the model increases the
    residual and thus the estimated error, which can be at most the assumed one.
    1 if there is no such part, or its covariance is zero.

    Source: restricted likelihood, Patterson & Thompson 1971, Biometrika 58:545.
    """
    part = next((each.covariance for each in noise.parts if each.name == name), None)
    if part is None or not part.any():
        return 1.0
    others = noise.covariance - part
    lengths = np.linalg.norm(jacobian, axis=0)
    columns = jacobian[:, lengths > 0] / lengths[lengths > 0]

    def cost(log_share: float) -> float:
        return _restricted(residual, columns, others + np.exp(2 * log_share) * part)

    low = float(np.log(least))
    found = minimize_scalar(cost, bounds=(low, 0.0), method="bounded", options={"xatol": _EXACT})
    ends = {float(found.x): float(found.fun), low: cost(low), 0.0: cost(0.0)}
    return float(np.exp(min(ends, key=lambda at: ends[at])))


def _restricted(residual: Array, columns: Array, covariance: Array) -> float:
    """Negative restricted log-likelihood, up to a constant."""
    factor = cholesky(covariance, lower=True)
    off = solve_triangular(factor, residual, lower=True)
    basis, upper = np.linalg.qr(solve_triangular(factor, columns, lower=True))
    left = off - basis @ (basis.T @ off)
    sizes = np.abs(np.concatenate([np.diag(factor), np.diag(upper)]))
    return float(0.5 * left @ left + np.log(np.maximum(sizes, 1e-300)).sum())
