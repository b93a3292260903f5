"""Does an explanation predict what it has not seen?"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Data, Fitted, Mask
from limbcli.model import Array


def held_out_error(data: Data, fitted: Fitted) -> dict[str, float]:
    """Root mean square of (held-out data - prediction) / deviation, block by block, and over all.

    Each block is left out in turn, the parameters (the effects' too) are refitted to the rest
    to first order about the full fit, and the block is predicted. A block that holds what tells
    a parameter, so that the rest predicts it no better than it is read (`TOO_WIDE`), is skipped.
    """
    residual = data.y - fitted.prediction
    covariance = data.noise.covariance
    J = fitted.jacobian[:, np.any(fitted.jacobian != 0.0, axis=0)]  # what a bound holds does not move
    found: dict[str, float] = {}
    squares: list[Array] = []
    for name, mask in _usable(data.blocks, J).items():
        keep = ~mask
        inverse = np.linalg.inv(covariance[np.ix_(keep, keep)])
        normal = J[keep].T @ inverse @ J[keep]
        spread = np.einsum("ij,jk,ik->i", J[mask], np.linalg.pinv(normal, rcond=1e-14), J[mask])
        if np.sqrt(np.mean(spread / data.deviation[mask] ** 2)) > thresholds.TOO_WIDE:
            continue
        step = np.linalg.lstsq(normal, J[keep].T @ inverse @ residual[keep], rcond=1e-14)[0]
        error = (residual[mask] - J[mask] @ step) / data.deviation[mask]
        found[name] = float(np.sqrt(np.mean(error**2)))
        squares.append(error**2)
    if squares:
        found["all"] = float(np.sqrt(np.mean(np.concatenate(squares))))
    return found


def fell(before: Mapping[str, float], after: Mapping[str, float]) -> bool:
    """Whether the error fell, over the blocks that both models can predict; True where there are none.

    >>> fell({"a": 2.0, "b": 1.0, "all": 1.6}, {"a": 1.0, "all": 1.0})
    True
    """
    both = [name for name in before if name in after and name != "all"]
    if not both:
        return True
    return sum(after[name] ** 2 for name in both) < sum(before[name] ** 2 for name in both)


def _usable(blocks: Mapping[str, Mask], J: Array) -> dict[str, Mask]:
    scale = np.where(np.linalg.norm(J, axis=0) > 0, np.linalg.norm(J, axis=0), 1.0)
    usable = {}
    for name, mask in blocks.items():
        if not 0 < mask.sum() < len(mask):
            continue
        s = np.linalg.svd(J[~mask] / scale, compute_uv=False)
        if len(s) == J.shape[1] and (not len(s) or s[-1] > 1e-6 * s[0]):
            usable[name] = mask
    return usable
