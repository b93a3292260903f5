"""Fibre direction from pennation angles measured in the planes of ultrasound images.

In an image with lateral axis l and beam direction b, fibres at angle a appear along p = cos a l + sin a b.
One image does not show how far they leave its plane; two determine the direction: it is perpendicular to q_i
= -sin a_i l_i + cos a_i b of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import CaseError
from limbcli.model import Array

# smallest angle between the planes' perpendiculars; below it they do not determine a direction
_LEAST_ANGLE_DEG = 10.0
_STEP_DEG = 0.01


@dataclass(frozen=True, eq=False)
class ImageAngle:
    """A pennation angle in one image.

    lateral : (3,) unit vector in the plane of the skin
    angle_deg, deviation_deg : as in `Pennation`
    """

    lateral: Array
    angle_deg: float
    deviation_deg: float


@dataclass(frozen=True, eq=False)
class FibreDirection:
    """Result of `direction_of_angles`.

    axis : (3,) unit vector; deviation_deg : standard deviation from that of the inputs; how : description
    """

    axis: Array
    deviation_deg: float
    how: str


def direction_of_angles(
    angles: Sequence[ImageAngle], beam: Array, *, proximal: Array, where: str = "site"
) -> FibreDirection:
    """The fibre axis from one or two image angles.

    beam (3,) : unit, into the tissue; proximal (3,) : unit, along the limb

    Raises CaseError if the only image is across the limb, or two images lie in nearly the same plane.

    >>> axial = ImageAngle(np.array([0.0, 0, 1]), 30.0, 2.0)
    >>> direction_of_angles([axial], np.array([0.0, 1, 0]), proximal=np.array([0.0, 0, 1])).axis.round(3)
    array([0.   , 0.5  , 0.866])
    """
    if len(angles) == 1:
        only = angles[0]
        if abs(float(only.lateral @ proximal)) < np.cos(np.radians(45.0)):
            raise CaseError(
                "the pennation is given only in an image across the limb; fibres cross that "
                "plane, so it does not determine their direction",
                where=where,
                fix='add one with orientation = "axial", or give fibre_direction',
            )
        how = "in one image plane; the angle of the fibres out of it is not given, and taken as 0"
        a = np.radians(only.angle_deg)
        return FibreDirection(np.cos(a) * only.lateral + np.sin(a) * beam, only.deviation_deg, how)
    steps = [replace(each, angle_deg=each.angle_deg + _STEP_DEG) for each in angles]
    axis = _crossing(angles, beam, where)
    moved = [_crossing([steps[0], angles[1]], beam, where), _crossing([angles[0], steps[1]], beam, where)]
    turned = [min(1.0, float(np.linalg.norm(np.cross(axis, each)))) for each in moved]
    rates = [float(np.degrees(np.arcsin(each))) / _STEP_DEG for each in turned]
    deviation = float(np.hypot(rates[0] * angles[0].deviation_deg, rates[1] * angles[1].deviation_deg))
    return FibreDirection(axis, deviation, "in two image planes")


def _crossing(angles: Sequence[ImageAngle], beam: Array, where: str) -> Array:
    turns = np.radians([each.angle_deg for each in angles])
    q = [-np.sin(a) * each.lateral + np.cos(a) * beam for a, each in zip(turns, angles, strict=True)]
    crossed = np.cross(q[0], q[1])
    size = float(np.linalg.norm(crossed))
    if size < np.sin(np.radians(_LEAST_ANGLE_DEG)):
        raise CaseError(
            "the two pennation angles do not determine a direction: both give nearly the same plane",
            where=where,
            fix="give them in planes further apart (axial and transverse)",
        )
    axis = crossed / size
    first = angles[0].lateral
    return np.asarray(axis if axis @ first >= 0 else -axis)


def mean_axis(axes: Array) -> tuple[Array, float]:
    """Mean of axes (n, 3) without sign, and their root-mean-square angle to it (deg).

    >>> mean_axis(np.array([[0.0, 0, 1], [0, 0, -1]]))[0]
    array([0., 0., 1.])
    """
    mean = np.einsum("ni,nj->ij", axes, axes) / len(axes)
    axis = np.linalg.eigh(mean)[1][:, 2]
    axis = axis * (1.0 if axis[int(np.argmax(np.abs(axis)))] >= 0 else -1.0)
    cosine = np.clip(np.abs(axes @ axis), 0.0, 1.0)
    return axis, float(np.degrees(np.sqrt(np.mean(np.arccos(cosine) ** 2))))
