"""The patient frame, LPS: x to the left, y posterior, z to the head; mm."""

from __future__ import annotations

import numpy as np

from limbcli.model import Array

HEAD = np.array([0.0, 0.0, 1.0])
_SIDES = (("right", "left"), ("anterior", "posterior"), ("foot", "head"))  # along -, + of patient LPS
_ALSO = 0.5  # of a direction's length: a second side is named, too, beyond 30 degrees


def toward_head(axis: Array) -> Array:
    """The axis, turned over where it points away from the head (LPS: +z)."""
    return axis if axis @ HEAD >= 0 else -axis


def side_of(direction: Array) -> str:
    """The side of the patient that a direction (3,) in LPS points to.

    >>> [side_of(np.array(each)) for each in ((-1.0, 0.1, 0.0), (0.0, -7.0, 9.0), (0.0, 9.0, -4.0))]
    ['right', 'head and anterior', 'posterior']
    """
    share = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    axes = [k for k in np.argsort(-np.abs(share), kind="stable") if abs(share[k]) > _ALSO]
    return " and ".join(_SIDES[k][int(share[k] > 0)] for k in axes)
