"""Where bones belong that were brought in another frame than the skin.

A bone that lies outside the skin was moved on its way: another origin, mostly. The one shift, the same for
all such bones, is looked for that puts them within the skin, beside the bones that lie right and apart from
them: the head of the fibula against the lateral condyle of the tibia, the patella before the femur.
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

# mm: what lies between, and one standard deviation. Chosen with four limbs of OpenLimb in view, which have
# 1.6 to 3.6 mm between fibula and tibia, and the fibula's apex 18 to 24 mm below the top of the tibia; that
# between patella and femur is a guess. No other limb has been tried.
_JOINT, _BELOW_TOP, _KNEECAP = (2.5, 1.0), (18.0, 5.0), (5.0, 2.0)
_HEAD = 15.0  # mm of the fibula, from its apex
_SKIN, _APART = 3.0, 1.5  # mm at least between a bone and the skin, and between two bones
_SOFT_SKIN, _SOFT_BONE = 2.0, 0.7  # mm, one deviation of that
_TIBIA_TO_HEAD = 38.0  # mm between their middles, where the search begins (35 to 42 in those limbs)
_BEHIND = np.radians([10.0, 35.0, 60.0])  # of lateral, towards the back: limbs lie turned in the scanner
_POINTS = 300  # of a bone that are looked at
_TOP = 0.995  # quantile that stands for a bone's end
_MISFIT, _DOUBT = 3.0, 6.0  # deviations of what must hold, mm across the limb: beyond, no shift is proposed


@dataclass(frozen=True, eq=False)
class PutBack:
    """names : the bones that were moved together; move (3,) : mm, patient LPS; deviation_mm : one standard
    deviation of the move across the limb, mm."""

    names: tuple[str, ...]
    move: Array
    deviation_mm: float


def put_back(
    skin: Triangles, right: Mapping[str, Triangles], wrong: Mapping[str, Triangles], *, limb: str
) -> PutBack | None:
    """The shift that puts the bones `wrong` back beside those that are `right`; None if undetermined.

    skin, right, wrong : closed surfaces, mm, patient LPS, bones by name; limb : "left" or "right"

    Needs a tibia that lies right and a fibula that does not; with a patella moved as it was, and the femur,
    the place is known to some 5 mm, seldom without.
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
    if uncertainty > _DOUBT:
        return None
    return PutBack(tuple(wrong), np.asarray(best.x, float), uncertainty)


class _Search:
    """Residuals of a shift, in deviations: what must hold between skin and bones."""

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
        """Distances that are known."""
        return 2 + (self.femur is not None)

    def _upward(self, right: Mapping[str, Triangles], tibia: Triangles) -> Array:
        """Unit vector along the tibia, towards the femur; without one, to the head (+z of LPS)."""
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
        """Shifts (3,) that put the head of the fibula lateral of the tibia and behind it."""
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
        """(n,) in deviations: overlaps and what stands out of the skin, and the known distances."""
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
