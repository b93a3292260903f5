"""A grid of named skin points: possible places of sites."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from limbcli.files.plain_text import text_cell
from limbcli.meshing.facets import divided
from limbcli.meshing.frame import proximal_direction, ray_hits
from limbcli.meshing.mending import Limb
from limbcli.meshing.sites_on_skin import triple
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

_STEP_MM, _MOST_ROWS = 20.0, 24
_ANGLES = 12
_BONE_EDGE = 2.0  # mm, longest edge of the divided bones, so that their points represent their surfaces
_NAMES = "ABCDEFGHIJKLMNOPQRSTUVWX"


@dataclass(frozen=True, eq=False)
class GridPoint:
    """A skin point and its name: "C4" is row C from distal, column 4 of 12 from anterior towards the left.

    nearest_bone : distance to the closest point of any bone, mm; never more than the distance along a beam
        (`skin_bone_mm` of a case), which it must not be taken for
    """

    name: str
    angle_deg: float
    point: Array
    nearest_bone: float


def grid_points(limb: Limb) -> list[GridPoint]:
    """Skin points every `_STEP_MM` along the limb (more if it is long) and every 30 degrees around it.

    0 degrees is anterior (-y of LPS), 90 the patient's left. The ends of the limb are left out.
    """
    axis = proximal_direction(limb)
    along = limb.skin.points @ axis
    low, high = float(along.min()), float(along.max())
    step = max(_STEP_MM, (high - low) / _MOST_ROWS)
    anterior = np.array([0.0, -1.0, 0.0]) - (np.array([0.0, -1.0, 0.0]) @ axis) * axis
    anterior /= np.linalg.norm(anterior)
    left = np.cross(axis, anterior)
    bones = [divided(each.points, each.faces, _BONE_EDGE)[0] for each in limb.bones]
    bone = cKDTree(np.concatenate(bones)) if bones else None
    found = []
    for row, height in enumerate(np.arange(low + step, high - 0.5 * step, step)):
        section = _section(limb.skin, axis, float(height))
        if section is None:
            continue
        middle, corners = section
        for column in range(_ANGLES):
            angle = 2 * np.pi * column / _ANGLES
            direction = np.cos(angle) * anterior + np.sin(angle) * left
            hits = ray_hits(middle, direction, corners)
            if not len(hits):
                continue
            point = middle + hits.max() * direction
            far = float(bone.query(point)[0]) if bone is not None else float("nan")
            found.append(GridPoint(f"{_NAMES[row]}{column + 1}", 360.0 * column / _ANGLES, point, far))
    return found


def _section(skin: Triangles, axis: Array, height: float) -> tuple[Array, Array] | None:
    """The centre (3,) of a cross section, and the corners (n, 3, 3) of the triangles that it cuts."""
    along = skin.points[skin.faces] @ axis
    crossing = (along.min(axis=1) <= height) & (along.max(axis=1) >= height)
    if not crossing.any():
        return None
    cut = skin.part(crossing)
    middle = np.average(cut.centroids, axis=0, weights=cut.areas)
    middle += (height - middle @ axis) * axis
    return middle, cut.corners


def write_grid(path: Path, grid: Sequence[GridPoint]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        rows = csv.writer(stream)
        rows.writerow(["name", "angle_deg", "x_mm", "y_mm", "z_mm", "nearest_bone_mm", "position_mm"])
        for each in grid:
            place = [f"{value:.1f}" for value in each.point]
            rows.writerow(
                [
                    text_cell(each.name),
                    f"{each.angle_deg:.0f}",
                    *place,
                    f"{each.nearest_bone:.1f}",
                    triple(each.point),
                ]
            )
