"""Model-form error: what an explanation may leave, as no model of fat or of a scar is just that of the limb.

A large effect leaves a small share of what it changes, where it changes it. A test of what is left allows
for that share: of the change in the channels that the test looks at, no more than the effect explains.
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
    """Deviance by the name of each test of a family.

    whiten : by which the family's directions were whitened; explained : deviance that the effects take
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
    """The estimate; all of a direction alike where there is none."""
    return eta if np.any(eta) else np.ones(len(eta))
