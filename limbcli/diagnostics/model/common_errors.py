"""Errors common to many data, as every fit estimates them beside its parameters.

The noise contains single unknowns with a prior: a gain, a calibration, the compressibility. With their
covariance, generalised least squares gives the same parameters and chi2 as a fit in which each of them is one
more parameter with its prior. This module gives that fit's estimates.

Source: Robinson 1991, Stat Sci 6:15 (best linear unbiased prediction, and its equivalence to that fit).
"""

from __future__ import annotations

from dataclasses import dataclass

from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.model.noise import Noise


@dataclass(frozen=True)
class CommonError:
    """One unknown that many data have in common, in standard deviations of its prior.

    value : its estimate, 0 where the data do not determine it; deviation : its standard deviation, then 1
    """

    name: str
    value: float
    deviation: float


def common_errors(noise: Noise, whiten: Whitener, state: LinearFit) -> tuple[CommonError, ...]:
    """Estimates of all noise parts that are a single unknown, at a fit.

    whiten : of the whole noise; state : of the fit, whitened
    """
    found = []
    for part in noise.parts:
        if part.direction is None or not part.direction.any():
            continue
        seen = state.project(whiten(part.direction))
        left = max(1.0 - float(seen @ seen), 0.0)
        found.append(CommonError(part.name, float(seen @ state.residual), left**0.5))
    return tuple(found)
