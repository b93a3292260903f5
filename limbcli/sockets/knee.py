"""Shear and moment at the knee centre, as forces on the socket."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.model import Array

_TOP_MM = 10.0  # of the tibia: its centre is that of the knee
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
