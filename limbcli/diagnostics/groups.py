"""Where: tests of parts of the data (a channel, a third of the levels, a site, an image region)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from limbcli.diagnostics.bench import Mask
from limbcli.diagnostics.linear import Whitener
from limbcli.diagnostics.score import Direction, Trial
from limbcli.model import Array

PREFIX = "where: "


def group_trials(whiten: Whitener, groups: Mapping[str, Mask]) -> list[Trial]:
    """One trial a group: shifts of its data, each on its own: T = r'E (E'PE)^+ E'r, E = L^-1 I_g.

    Groups of every datum are left out: that is the test of everything.
    """
    trials = []
    for name, mask in groups.items():
        if not 0 < mask.sum() < len(mask):
            continue
        columns = whiten(np.eye(len(mask))[:, mask])
        trials.append(Trial(PREFIX + name, (Direction(columns, (0,) * int(mask.sum())),)))
    return trials


def predicted_without(
    raw_residual: Array, raw_jacobian: Array, covariance: Array, mask: Mask
) -> tuple[float, float]:
    """Refit without a group and predict it: (root mean square, largest) of z = error / its deviation.

    The deviation includes that of the parameters fitted to the rest.

    >>> last = np.array([False, False, True])
    >>> predicted_without(np.array([1.0, 1.0, 4.0]), np.ones((3, 1)), np.eye(3), last)
    (2.449..., 2.449...)
    """
    keep = ~mask
    inverse = np.linalg.inv(covariance[np.ix_(keep, keep)])
    J, J_out = raw_jacobian[keep], raw_jacobian[mask]
    bread = np.linalg.pinv(J.T @ inverse @ J)
    gain = covariance[np.ix_(mask, keep)] @ inverse
    step = bread @ J.T @ inverse @ raw_residual[keep]
    error = raw_residual[mask] - J_out @ step - gain @ (raw_residual[keep] - J @ step)
    left = J_out - gain @ J
    spread = covariance[np.ix_(mask, mask)] - gain @ covariance[np.ix_(keep, mask)] + left @ bread @ left.T
    z = error / np.sqrt(np.maximum(np.diag(spread), 1e-300))
    return float(np.sqrt(np.mean(z**2))), float(np.max(np.abs(z)))
