"""Effects that the data cannot detect, and the bias they would cause in the fitted parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.evidence.laplace import Posterior
from limbcli.diagnosis.explanations.evidence.linear_evidence import Added
from limbcli.model import Array
from limbcli.numbers.whitening import Whitener

_Z = float(ndtri(decisions.POWER))


@dataclass(frozen=True, kw_only=True)
class BlindSpot:
    """Detectability of one effect at its typical (a plausible) size.

    visible_fraction : |P H| / |H|, the share of its signature that the fitted parameters cannot reproduce
    detectable_times_typical : the size detected with 80 % power, in units of the typical size
    bias_sd : by base parameter, the bias from an undetected effect of typical size, in
        standard deviations; bias_percent : the same in per cent (the parameters are logarithms)
    """

    name: str
    point: str
    visible_fraction: float
    detectable_times_typical: float
    bias_sd: Mapping[str, float]
    bias_percent: Mapping[str, float]

    @property
    def is_undetectable(self) -> bool:
        return self.detectable_times_typical > 1.0

    @property
    def matters(self) -> bool:
        """Whether an effect of typical size would be undetected and bias a parameter by more than one
        standard deviation."""
        return self.is_undetectable and any(
            abs(each) > decisions.BIAS_MATTERS_SD for each in self.bias_sd.values()
        )


def blind_spot(
    name: str, added: Added, typical: Array, nothing: Posterior, whiten: Whitener, *, ln_factor: float
) -> BlindSpot:
    """
    Parameters
    ----------
    added : the effect at one point of its grid; typical : (q,) distance from the null value
    nothing : the fit without effects; whiten : as that of `added`
    ln_factor : Bayes factor at which the model is no longer adequate
    """
    moved, seen = added.columns @ typical, added.seen @ typical
    size, information = float(np.linalg.norm(moved)), float(moved @ seen)
    fitted = nothing.fitted
    shift = nothing.covariance @ (whiten(fitted.jacobian).T @ moved)
    of_base = list(zip(fitted.base_names, shift, nothing.deviation, strict=False))
    bias = {key: float(moved_by / max(deviation, 1e-300)) for key, moved_by, deviation in of_base}
    percent = {key: float(100 * np.expm1(np.clip(moved_by, -5, 5))) for key, moved_by, _ in of_base}
    prior = float(np.min((typical / added.deviation)[typical != 0] ** 2)) if np.any(typical) else 0.0
    one_sided = bool(np.any((added.low >= 0.0) | (added.high <= 0.0)))
    needed = ln_factor - (math.log(2.0) if one_sided else 0.0)
    return BlindSpot(
        name=name, point=added.direction.point,
        visible_fraction=math.sqrt(max(information, 0.0)) / size if size > 0 else 0.0,
        detectable_times_typical=_detectable(information, prior, needed), bias_sd=bias, bias_percent=percent,
    )  # fmt: skip


def _detectable(information: float, prior: float, ln_factor: float) -> float:
    """Size, in units of that with this information (reciprocal variance) and prior precision, whose Bayes
    factor exceeds exp(ln_factor) with the stated power; infinite where it is invisible.

    >>> round(_detectable(100.0, 0.0001, 0.0), 3)  # 3.72 standard deviations and 0.84 for the power
    0.456
    """
    if information <= 0.0:
        return math.inf
    needed = 2.0 * (information + prior) / information**2 * (
        ln_factor + 0.5 * math.log1p(information / max(prior, 1e-12))
    )  # fmt: skip
    return math.sqrt(max(needed, 0.0)) + _Z / math.sqrt(information)
