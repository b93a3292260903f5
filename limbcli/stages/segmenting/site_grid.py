"""Possible places of sites: a grid of named skin points, drawn with markers and sites from four sides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from scipy.spatial import cKDTree

from limbcli.drawing import Margins, panel_sheet, save_picture
from limbcli.files.plain_text import write_rows
from limbcli.meshing.facets import divided
from limbcli.meshing.frame import around, cut_across, proximal_direction, ray_hits
from limbcli.meshing.mending import Limb
from limbcli.meshing.sites_on_skin import triple
from limbcli.model import Array
from limbcli.reporting.figures.limb_views import VIEWS, draw_skin

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


_LETTERS = ("x", "y", "z")
_NEAR = 10.0  # mm, distance to the nearest bone below which a point is drawn in another colour
_SLICE = 15.0  # mm, half-length of the section whose centre determines on which side of the limb a point is
_ROUND = 12.0  # mm, margin around the limb
_MOST_ACROSS, _MOST_DOWN = 16.0, 9.0  # inches, largest size of all views together, which share one scale
_LEAST_ACROSS = 2.2  # inches, least width of a view, for its title
_MARGINS = Margins(left=0.8, above=0.35, below=1.0, gap=0.15)
_THIN, _THICK, _MARKER, _SITE = "#c25a00", "#1b3a1b", "#c000c0", "#0050d0"


def draw_places(
    path: Path, limb: Limb, grid: Sequence[GridPoint], markers: Mapping[str, Array],
    sites: Mapping[str, Array], *, title: str,
) -> None:  # fmt: skip
    """Draw the four views, with names at the grid points; the table has their coordinates."""
    low, high = limb.skin.points.min(axis=0) - _ROUND, limb.skin.points.max(axis=0) + _ROUND
    middle, sizes = 0.5 * (low + high), high - low
    across_mm = [float(sizes[view.across[0]]) for view in VIEWS]
    inches_per_mm = min(_MOST_ACROSS / sum(across_mm), _MOST_DOWN / float(sizes[2]))
    across_mm = [max(each, _LEAST_ACROSS / inches_per_mm) for each in across_mm]
    words = f"{title}: where a site can be (coordinates of the grid’s points: site-grid.csv)"
    widths, heights = [each * inches_per_mm for each in across_mm], [float(sizes[2]) * inches_per_mm]
    figure, places = panel_sheet(widths, heights, _MARGINS, words)
    for number, view in enumerate(VIEWS):
        across, towards = view.across, view.towards
        axes = figure.add_subplot(places[number])
        draw_skin(axes, limb.skin.points, limb.skin.faces, view)
        _draw_points(axes, grid, markers, sites, limb, across, towards)
        sign = "" if across[1] > 0 else ", turned"
        axes.set(title=view.name, xlabel=f"{_LETTERS[across[0]]} [mm], patient LPS{sign}", ylabel="z [mm]")
        half = 0.5 * across[1] * across_mm[number]  # negative (reversed) if the axis points to the left
        axes.set(xlim=(middle[across[0]] - half, middle[across[0]] + half), ylim=(low[2], high[2]))
        axes.label_outer()
        axes.grid(True, linewidth=0.4, alpha=0.5)
    # a legend of the marks that are present
    thin = [each for each in grid if each.nearest_bone < _NEAR]
    marks = (
        (len(thin) < len(grid), ".", _THICK, "point of the grid"),
        (bool(thin), ".", _THIN, f"the same, less than {_NEAR:g} mm to the nearest bone"),
        (bool(markers), "D", _MARKER, "skin marker"),
        (bool(sites), "X", _SITE, "site of the case"),
    )
    lines = [
        Line2D([], [], marker=mark, color=colour, linestyle="none", label=label)
        for there, mark, colour, label in marks
        if there
    ]
    if lines:
        figure.legend(handles=lines, loc="lower center", ncols=len(lines))
    save_picture(figure, path, dpi=70)


def _draw_points(
    axes: Axes, grid: Sequence[GridPoint], markers: Mapping[str, Array], sites: Mapping[str, Array],
    limb: Limb, across: tuple[int, float], towards: tuple[int, float],
) -> None:  # fmt: skip
    """Draw the points that are visible from this side; points hidden by the limb are not drawn."""
    axis = proximal_direction(limb)
    along = limb.skin.points @ axis
    centre = 0.5 * (limb.skin.points.min(axis=0) + limb.skin.points.max(axis=0))

    def visible(point: Array) -> bool:
        near = limb.skin.points[np.abs(along - point @ axis) < _SLICE]
        middle = (near if len(near) else limb.skin.points).mean(axis=0)
        aside, front = point - middle, towards[1] * (point - middle)[towards[0]]
        return bool(front > 0.35 * np.hypot(aside[0], aside[1]))

    seen = [each for each in grid if visible(each.point)]
    for colour, shown in (
        (_THIN, [each for each in seen if each.nearest_bone < _NEAR]),
        (_THICK, [each for each in seen if not each.nearest_bone < _NEAR]),
    ):
        places = np.array([each.point[[across[0], 2]] for each in shown]).reshape(-1, 2)
        axes.plot(*places.T, ".", color=colour, markersize=4)
        for each, (x, z) in zip(shown, places, strict=True):
            label = axes.annotate(
                each.name, (x, z), xytext=(0, 3), color=colour,
                textcoords="offset points", fontsize=8, ha="center",
            )  # fmt: skip
            label.set_in_layout(False)  # it lies within its view, and measuring every label takes time
    for points, mark, colour, word, above in (
        (markers, "D", _MARKER, "marker ", -10), (sites, "X", _SITE, "", 4)
    ):  # fmt: skip
        for name, point in points.items():
            if visible(point):
                axes.plot(point[across[0]], point[2], mark, color=colour, markersize=9)
                is_left = across[1] * (point - centre)[across[0]] < 0
                axes.annotate(
                    f"{word}{name}", (point[across[0]], point[2]), xytext=(6 if is_left else -6, above),
                    ha="left" if is_left else "right", fontweight="bold",
                    textcoords="offset points", color=colour, fontsize=10, zorder=5,
                    bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.8},
                )  # fmt: skip
