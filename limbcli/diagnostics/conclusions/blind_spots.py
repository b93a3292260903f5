"""Effects that the data cannot detect, and the bias they would cause in the fitted parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Direction
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.diagnostics.statistical_tests.score import visible_columns
from limbcli.model import Array

_Z = float(norm.ppf(thresholds.POWER))


@dataclass(frozen=True)
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
            abs(each) > thresholds.BIAS_MATTERS_SD for each in self.bias_sd.values()
        )


def blind_spot(
    state: LinearFit, name: str, direction: Direction, typical: Array, *,
    critical: float, base_names: tuple[str, ...], scale: float = 1.0,
) -> BlindSpot:  # fmt: skip
    """
    Parameters
    ----------
    typical : (q,) distance from the null value; critical : statistic that is just significant
    scale : chi2/nu where the noise level is unknown, else 1
    """
    moved = direction.columns @ typical
    seen = visible_columns(state, direction) @ typical
    size, visible = float(np.linalg.norm(moved)), float(np.linalg.norm(seen))
    needed = float(np.sqrt(max(critical, 0.0))) + _Z * float(np.sqrt(scale))
    shift = state.estimator()[: len(base_names)] @ moved
    covariance = np.linalg.pinv(state.jacobian.T @ state.jacobian)
    deviation = np.sqrt(scale * np.maximum(np.diag(covariance)[: len(base_names)], 1e-300))
    return BlindSpot(
        name,
        direction.point,
        visible / size if size > 0 else 0.0,
        needed / visible if visible > 0 else float("inf"),
        {key: float(value) for key, value in zip(base_names, shift / deviation, strict=True)},
        dict(zip(base_names, (float(100 * np.expm1(np.clip(x, -5, 5))) for x in shift), strict=True)),
    )
