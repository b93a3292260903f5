"""Localisation: tests of parts of the data (a channel, a third of the levels, a site, an image region)."""

from __future__ import annotations

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Data, Direction, Mask
from limbcli.diagnostics.model.linear import Whitener
from limbcli.diagnostics.statistical_tests.score import Trial
from limbcli.model import Array

PREFIX = "where: "


def group_trials(whiten: Whitener, data: Data) -> list[Trial]:
    """One trial per group: T = r'E (E'PE)^+ E'r, E = L^-1 B_g.

    For a small group, B_g shifts each datum separately. For a large one (parts of images) it shifts the data
    together, as low-order polynomials of level and position. A group of all data is left out: that is the
    overall test.
    """
    trials = []
    for name, mask in data.groups.items():
        if not 0 < mask.sum() < len(mask):
            continue
        shifts = np.eye(len(mask))[:, mask] if mask.sum() <= thresholds.FEW_DATA else _even(data, mask)
        trials.append(Trial(PREFIX + name, (Direction(whiten(shifts), (0,) * shifts.shape[1]),)))
    return trials


def _even(data: Data, mask: Mask) -> Array:
    """Smooth shifts (n, 9) of a group: up to quadratic in the level number and linear in the position."""
    t = _scaled(data.order, mask)
    place = np.zeros((len(mask), 2)) if data.place is None else np.nan_to_num(data.place)
    x, z = (_scaled(each, mask) for each in place.T)
    found = [np.where(mask, a * b, 0.0) for a in (np.ones_like(t), t, t**2) for b in (np.ones_like(t), x, z)]
    return np.stack(found, axis=1)


def _scaled(values: Array, mask: Mask) -> Array:
    """Values scaled to -1 to 1 within the group."""
    low, high = values[mask].min(), values[mask].max()
    return np.asarray(2 * (values - low) / max(high - low, 1e-9) - 1)


def predicted_without(
    raw_residual: Array, raw_jacobian: Array, covariance: Array, mask: Mask
) -> tuple[float, float]:
    """Refit without a group and predict it: (root mean square, largest |z|), z = error / standard deviation.

    The standard deviation includes that of the parameters fitted to the other data.

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
