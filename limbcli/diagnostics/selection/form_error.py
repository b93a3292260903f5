"""Model-form error: residual allowed for an effect, as no model of fat or of a scar matches the limb exactly.

A large effect leaves a residual that is a small fraction of the change it causes. The tests of the residual
allow for this fraction of the change in the channels they examine, at most that of the explained deviance.
"""

from __future__ import annotations

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Data, Fitted
from limbcli.diagnostics.model.linear import Whitener
from limbcli.diagnostics.statistical_tests.multiple_testing import Family
from limbcli.model import Array


def form_allowances(
    data: Data, fitted: Fitted, family: Family, whiten: Whitener, explained: float
) -> dict[str, float]:
    """Allowed deviance for each test of a family, by name.

    whiten : the whitening used for the family's directions; explained : deviance explained by the effects
    """
    if fitted.without is None:
        return {}
    change, covariance = fitted.prediction - fitted.without, data.noise.covariance
    masks = list(data.channels().values())
    changed = []
    for mask in masks:
        part = Whitener.of(covariance[np.ix_(mask, mask)])(change[mask])
        changed.append(float(part @ part))
    found = {}
    for each in family.tests:
        raw = whiten.undo(each.score.direction.columns @ _along(each.score.eta))
        share = np.array([np.sum((raw[mask] / data.deviation[mask]) ** 2) for mask in masks])
        changes = float(share @ changed) / max(float(share.sum()), 1e-300)
        found[each.name] = thresholds.OF_FORM * max(min(changes, explained), 0.0)
    return found


def _along(eta: Array) -> Array:
    """The estimate; ones where it is zero."""
    return eta if np.any(eta) else np.ones(len(eta))
