"""Shear and moment at the knee centre, as forces on the socket."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import CaseError
from limbcli.model import Array
from limbcli.sockets.centre_line import CentreLine

_TOP_MM = 10.0  # of the tibia: its centre is that of the knee
_ABOVE_CUT_MM = 150.0  # a knee centre farther above the proximal cut is not believed: chosen
_OUT_OF_CUT_MM = 3.0  # a bone nearer to the proximal cut is cut itself


@dataclass(frozen=True)
class KneeLoad:
    """What acts on the socket besides the force along the limb: the opposite of the thigh's load on the limb.

    centre (3,) : the knee's, mm: the moment is about it, and the force along the limb acts through it
    force (3,) : N, across the limb; moment (3,) : N mm
    """

    centre: tuple[float, float, float]
    force: tuple[float, float, float]
    moment: tuple[float, float, float]

    def moment_about(self, point: Array) -> Array:
        """Moment (3,) of the force across the limb and of the moment, N mm, about another point (3,)."""
        return np.asarray(self.moment + np.cross(np.asarray(self.centre) - point, self.force))


def check_knee(centre: Array, line: CentreLine) -> None:
    """Refuse a knee centre (3,) that cannot be this limb's: beside it, below its tip, or far above its cut.

    line : the limb's centre line

    Raises CaseError with the distances.
    """
    point = np.asarray(centre, float)[None]
    height = float(line.height(point)[0])  # towards the tip
    at = float(np.clip(height, line.heights[0], line.heights[-1]))
    middle = np.array([np.interp(at, line.heights, each) for each in line.centres.T])
    away = point[0] - middle
    aside = float(np.linalg.norm(away - (away @ line.along) * line.along))
    radius = float(np.interp(at, line.heights, line.radii))
    above = float(line.heights[0] - height)
    where = ""
    if aside > radius:
        where = f"{aside:.0f} mm beside the limb's middle, which is {radius:.0f} mm thick there (radius)"
    elif height > line.heights[-1]:
        where = f"{height - line.heights[-1]:.0f} mm below the limb's distal end"
    elif above > _ABOVE_CUT_MM:
        where = f"{above:.0f} mm above the proximal cut"
    if where:
        raise CaseError(
            f"the knee centre lies {where}: it is no knee of this limb",
            where="socket.knee.centre_mm",
            fix="give it in mm, patient LPS, in the frame of the limb's surfaces; or leave it out: then it "
            "is the middle of the tibia's upper end",
            beside_mm=aside, above_mm=above,
        )  # fmt: skip


def knee_centre(tibia: Array, cut: float) -> Array | None:
    """The centre (3,) of the tibia's upper end; None if the tibia is cut.

    tibia (n, 3) : its points, mm, z up along the limb; cut : height of the proximal cut
    """
    top = float(tibia[:, 2].max())
    if top > cut - _OUT_OF_CUT_MM:
        return None
    plateau = tibia[tibia[:, 2] > top - _TOP_MM]
    middle = 0.5 * (plateau.min(axis=0) + plateau.max(axis=0))
    return np.array([middle[0], middle[1], top])
