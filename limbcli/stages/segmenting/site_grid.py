"""A grid of named skin points: possible places of sites."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from limbcli.files.plain_text import write_rows
from limbcli.meshing.facets import divided
from limbcli.meshing.frame import around, cut_across, proximal_direction, ray_hits
from limbcli.meshing.mending import Limb
from limbcli.meshing.sites_on_skin import triple
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
    bones = [divided(each.points, each.faces, _BONE_EDGE)[0] for each in limb.bones]
    bone = cKDTree(np.concatenate(bones)) if bones else None
    found = []
    for row, height in enumerate(np.arange(low + step, high - 0.5 * step, step)):
        section = cut_across(limb.skin, axis, float(height))
        if section is None:
            continue
        middle, corners = section
        for column in range(_ANGLES):
            angle = 2 * np.pi * column / _ANGLES
            direction = around(axis, angle)
            hits = ray_hits(middle, direction, corners)
            if not len(hits):
                continue
            point = middle + hits.max() * direction
            far = float(bone.query(point)[0]) if bone is not None else float("nan")
            found.append(GridPoint(f"{_NAMES[row]}{column + 1}", 360.0 * column / _ANGLES, point, far))
    return found


def write_grid(path: Path, grid: Sequence[GridPoint]) -> None:
    rows = (
        (each.name, f"{each.angle_deg:.0f}", *(f"{value:.1f}" for value in each.point),
         f"{each.nearest_bone:.1f}", triple(each.point))
        for each in grid
    )  # fmt: skip
    names = ("name", "angle_deg", "x_mm", "y_mm", "z_mm", "nearest_bone_mm", "position_mm")
    write_rows(path, names, rows)
