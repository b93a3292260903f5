"""Is the stated noise believable? Scatter that no smooth curve explains must be of its size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from limbcli.diagnostics.bench import Mask
from limbcli.diagnostics.linear import LinearFit, Whitener
from limbcli.model import Array

_DEGREE = 4
_LEAST_NU = 5


@dataclass(frozen=True)
class Roughness:
    """Scatter beyond a quartic along each series: ratio = chi2/nu (1: as stated), p of so much or more."""

    ratio: float
    nu: int
    p: float


def roughness(
    state: LinearFit, whiten: Whitener, *, series: Mapping[str, Mask], order: Array
) -> Roughness | None:
    """Compare the rough part of the residual with the stated noise; None where too few data are left."""
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
    return Roughness(wide.chi2 / wide.nu, wide.nu, float(stats.chi2.sf(wide.chi2, wide.nu)))
