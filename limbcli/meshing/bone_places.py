"""Estimate where bones belong that were supplied in another frame than the skin.

A bone that lies outside the skin has usually been shifted, for example by another origin. One translation
common to all such bones is sought that places them inside the skin, next to the correctly placed bones
without overlap: the head of the fibula against the lateral condyle of the tibia, the patella in front of the
femur.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from limbcli.meshing.anatomy import bone_named
from limbcli.meshing.distance import Heights
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

# Expected distances and their standard deviations, mm: tibia to fibula, apex of the fibula below the top of
# the tibia, patella to femur. Chosen from four limbs of OpenLimb, which have 1.6 to 3.6 mm between fibula and
# tibia, and the apex 18 to 24 mm below the top of the tibia; patella to femur is a guess. No other limb has
# been tried.
_JOINT, _BELOW_TOP, _KNEECAP = (2.5, 1.0), (18.0, 5.0), (5.0, 2.0)
_HEAD = 15.0  # length of the head of the fibula from its apex, mm
_SKIN, _APART = 3.0, 1.5  # smallest distances, mm: bone to skin, bone to bone
_SOFT_SKIN, _SOFT_BONE = 2.0, 0.7  # standard deviations of these two distances, mm
# initial distance between the centres of the tibia and the head of the fibula, mm (35 to 42 in the four
# limbs)
_TIBIA_TO_HEAD = 38.0
# initial directions, as angles from lateral towards posterior: limbs lie rotated in the scanner
_BEHIND = np.radians([10.0, 35.0, 60.0])
_POINTS = 300  # approximate largest number of points sampled per bone
_TOP = 0.995  # quantile of the points' heights that is taken as a bone's end
# No shift is proposed beyond this misfit (standard deviations) or this uncertainty across the limb (mm).
_MISFIT, _MOST_UNCERTAIN = 3.0, 6.0


@dataclass(frozen=True, eq=False)
class PutBack:
    """The proposed shift of misplaced bones.

    names : the bones that are moved together
    move : (3,) translation, mm, patient LPS
    deviation_mm : standard deviation of the translation across the limb, mm
    """

    names: tuple[str, ...]
    move: Array
    deviation_mm: float


def put_back(
    skin: Triangles, right: Mapping[str, Triangles], wrong: Mapping[str, Triangles], *, limb: str
) -> PutBack | None:
    """The translation that puts the bones `wrong` back beside the bones `right`; None if it is undetermined.

    skin, right, wrong : closed surfaces, mm, patient LPS, bones by name; limb : "left" or "right"

    Needs a correctly placed tibia and a misplaced fibula. If the patella was displaced with the fibula and
    the femur is correctly placed, the position is known to about 5 mm; otherwise seldom.
    """
    tibia, fibula = bone_named(right, "tibia"), bone_named(wrong, "fibula")
    if tibia is None or fibula is None:
        return None
    search = _Search(skin, right, wrong, tibia, fibula)
    found = [least_squares(search.misfit, start, max_nfev=60) for start in search.starts(limb)]
    best = min(found, key=lambda each: float(each.cost))
    if 2.0 * best.cost / search.n_known > _MISFIT**2:
        return None
    curvature = best.jac.T @ best.jac + 1e-3 * np.eye(3)
    spread = np.linalg.inv(curvature)
    across = np.eye(3) - np.outer(search.axis, search.axis)
    uncertainty = float(np.sqrt(np.linalg.eigvalsh(across @ spread @ across).max()))
    if uncertainty > _MOST_UNCERTAIN:
        return None
    return PutBack(tuple(wrong), np.asarray(best.x, float), uncertainty)


class _Search:
    """Least-squares residuals of a shift, in standard deviations: constraints between skin and bones."""

    def __init__(
        self, skin: Triangles, right: Mapping[str, Triangles], wrong: Mapping[str, Triangles],
        tibia: Triangles, fibula: Triangles,
    ):  # fmt: skip
        self.skin = Heights(skin)
        self.right = [Heights(each) for each in right.values()]
        self.wrong = [each.points[:: max(1, len(each.points) // _POINTS)] for each in wrong.values()]
        self.tibia, self.tibia_points = Heights(tibia), tibia.points
        self.axis = self._upward(right, tibia)
        self.tibia_top = self._top(tibia.points)
        self.fibula_top = self._top(fibula.points)
        self.head = fibula.points[fibula.points @ self.axis > self.fibula_top - _HEAD]
        femur, patella = bone_named(right, "femur"), bone_named(wrong, "patella")
        self.femur = None if femur is None or patella is None else Heights(femur)
        self.patella = None if patella is None else patella.points

    @property
    def n_known(self) -> int:
        """Number of known distances."""
        return 2 + (self.femur is not None)

    def _upward(self, right: Mapping[str, Triangles], tibia: Triangles) -> Array:
        """Unit vector along the tibia, towards the femur; without a femur, towards the head (+z of LPS)."""
        centred = tibia.points - tibia.points.mean(axis=0)
        axis = np.linalg.svd(centred, full_matrices=False)[2][0]
        femur = bone_named(right, "femur")
        up = np.array([0.0, 0.0, 1.0])
        if femur is not None:
            up = femur.points.mean(axis=0) - tibia.points.mean(axis=0)
        return np.asarray(axis if axis @ up >= 0 else -axis)

    def _top(self, points: Array) -> float:
        return float(np.quantile(points @ self.axis, _TOP))

    def starts(self, limb: str) -> list[Array]:
        """Initial guesses (3,) of the shift: the head of the fibula lateral of and behind the tibia."""
        lateral = np.array([1.0 if limb == "left" else -1.0, 0.0, 0.0])
        back = np.array([0.0, 1.0, 0.0])
        level = self.tibia_top - _BELOW_TOP[0] - 0.5 * _HEAD
        near = np.abs(self.tibia_points @ self.axis - level) < _HEAD
        centre = self.tibia_points[near].mean(axis=0)
        centre = centre + (level - centre @ self.axis) * self.axis
        found = []
        for angle in _BEHIND:
            way = np.cos(angle) * lateral + np.sin(angle) * back
            way = way - (way @ self.axis) * self.axis
            found.append(centre + _TIBIA_TO_HEAD * way / np.linalg.norm(way) - self.head.mean(axis=0))
        return found

    def misfit(self, move: Array) -> Array:
        """Residuals (n,) in standard deviations: overlaps, protrusion from the skin, known distances."""
        found = []
        for points in self.wrong:
            moved = points + move
            found.append(np.minimum(-self.skin.of(moved) - _SKIN, 0.0) / _SOFT_SKIN)
            found += [np.minimum(each.of(moved) - _APART, 0.0) / _SOFT_BONE for each in self.right]
        joint = self.tibia.of(self.head + move).min()
        below = self.tibia_top - self.fibula_top - move @ self.axis
        known = [(joint - _JOINT[0]) / _JOINT[1], (below - _BELOW_TOP[0]) / _BELOW_TOP[1]]
        if self.femur is not None and self.patella is not None:
            known.append((self.femur.of(self.patella + move).min() - _KNEECAP[0]) / _KNEECAP[1])
        return np.concatenate([*found, np.array(known)])
