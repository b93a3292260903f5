"""Check of the stated noise: the scatter about smooth curves must be consistent with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from limbcli.diagnostics.model.forward_model import Mask
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.model.noise import EXCESS
from limbcli.model import Array

_DEGREE = 4
_LEAST_NU = 5


@dataclass(frozen=True)
class Roughness:
    """Scatter about a quartic along each series: ratio = chi2/nu (1: as stated), p of this much or more."""

    ratio: float
    nu: int
    p: float


def roughness(
    state: LinearFit, whiten: Whitener, *, series: Mapping[str, Mask], order: Array
) -> Roughness | None:
    """Compare the rough part of the residual with the stated noise; None if fewer than `_LEAST_NU` degrees of
    freedom remain."""
    n = len(order)
    columns = [state.jacobian]
    for mask in series.values():
        x = order[mask]
        t = 2 * (x - x.min()) / max(float(np.ptp(x)), 1e-12) - 1
        degree = min(_DEGREE, len(np.unique(t)) - 1)
        smooth = np.zeros((n, degree + 1))
        smooth[mask] = np.polynomial.legendre.legvander(t, degree)
        columns.append(whiten(smooth))
    wide = LinearFit.of(state.residual, np.hstack(columns))
    if wide.nu < _LEAST_NU:
        return None
    return Roughness(wide.chi2 / wide.nu, wide.nu, _p(wide))


def _p(fit: LinearFit) -> float:
    """p of the sum of squares of heavy-tailed errors, approximated by a scaled chi2 (Satterthwaite).

    Mean nu, variance 2 nu + excess sum P_ii^2.
    """
    own = 1.0 - np.sum(fit.basis**2, axis=1)
    scale = 1.0 + EXCESS * float(own @ own) / (2.0 * fit.nu)
    return float(chdtrc(fit.nu / scale, fit.chi2 / scale))
