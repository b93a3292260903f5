"""The patient frame, LPS: x to the left, y posterior, z towards the head; mm."""

from __future__ import annotations

import numpy as np

from limbcli.model import Array, LimbModel

HEAD = np.array([0.0, 0.0, 1.0])
# sides of the patient towards - and + of each LPS axis
_SIDES = (("right", "left"), ("anterior", "posterior"), ("foot", "head"))
_ALSO = 0.5  # component (as a fraction of the length) above which a second side is named: beyond 30 degrees


def patient_from_model(model: LimbModel) -> Array:
    """Transformation (4, 4) from the site's frame to patient LPS; the identity if the model has none."""
    entries = model.info.get("patient_from_model")
    return np.eye(4) if entries is None else np.array(entries, dtype=float).reshape(4, 4)


def toward_head(axis: Array) -> Array:
    """The axis, reversed if it points away from the head (LPS: +z)."""
    return axis if axis @ HEAD >= 0 else -axis


def side_of(direction: Array) -> str:
    """The side of the patient towards which a direction (3,) in LPS points.

    >>> [side_of(np.array(each)) for each in ((-1.0, 0.1, 0.0), (0.0, -7.0, 9.0), (0.0, 9.0, -4.0))]
    ['right', 'head and anterior', 'posterior']
    """
    share = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    axes = [k for k in np.argsort(-np.abs(share), kind="stable") if abs(share[k]) > _ALSO]
    return " and ".join(_SIDES[k][int(share[k] > 0)] for k in axes)
