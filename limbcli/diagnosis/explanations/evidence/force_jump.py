"""A jump of the load cell's zero between two levels: an error of the measurement, no effect of the tissue.

A cell that is tared anew (or slips) while the probe rests on the limb adds one number to all later forces.
Such a step can resemble an effect; where it explains the readings as well as the chosen one, that is said.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.model.forward_model import Data, Fitted
from limbcli.diagnosis.explanations.model.linear import LinearFit
from limbcli.numbers.whitening import Whitener

_FEWEST = 2  # readings before and after a jump


@dataclass(frozen=True)
class ForceJump:
    """size : N, added to all forces from level `level` on; chi2 : reduction of the misfit without effects"""

    size: float
    level: int
    chi2: float

    @property
    def sentence(self) -> str:
        """
        >>> ForceJump(-0.82, 7, 24.0).sentence[:76]
        'Or the zero of the load cell jumped by about -0.8 N between levels 6 and 7, '
        """
        return (
            f"Or the zero of the load cell jumped by about {self.size:.1g} N between levels "
            f"{self.level - 1} and {self.level}, which explains the readings as well. If the cell was tared "
            "anew there, correct the later forces, or measure again."
        )


def force_jump(data: Data, base: Fitted, *, explained: float) -> ForceJump | None:
    """The jump that explains the misfit best; None if it explains little, or less than the chosen effects.

    base : the fit without effects; explained : chi2 by which the chosen effects reduce its misfit

    To first order in the base parameters; not of several measurements together. The place of a jump is chosen
    among those between all levels: its p is multiplied by their number, and 2 ln(their number) is taken off
    its chi2.
    """
    whiten = Whitener.of(data.noise.covariance)
    fit = LinearFit.of(whiten(data.y - base.prediction), whiten(base.jacobian))
    left = fit.project(fit.residual)
    found: list[ForceJump] = []
    mask = data.channels().get("force", np.zeros(len(data), dtype=bool))
    for level in np.unique(data.order[mask])[_FEWEST : 1 - _FEWEST]:
        step = fit.project(whiten((mask & (data.order >= level)).astype(float)))
        length = float(step @ step)
        if length > 0.0:
            pull = float(step @ left)
            found.append(ForceJump(pull / length, int(level), pull**2 / length))
    best = max(found, key=lambda each: each.chi2, default=None)
    if best is None or best.chi2 < chdtri(1, decisions.CHECKED / len(found)):
        return None
    return best if best.chi2 - 2.0 * np.log(len(found)) >= explained else None
