"""Pictures of a site's mesh: sections with or without its fibres, the skin from above, a refinement study."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from limbcli.drawing import Margins, panel_sheet, put_title, save_figure, save_picture
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.quality import MeshQuality, dihedral_angles_deg
from limbcli.model import Array, Block, IntArray, Mesh

if TYPE_CHECKING:
    from limbcli.meshing.mesh_extrapolation import Extrapolation  # finds a root with SciPy's optimisers

_PANEL_INCHES, _MARGINS = (4.1, 3.1), Margins(0.8, 0.4, 0.5, labelled=True)
_FIBRE_PANEL_INCHES, _FIBRE_MARGINS = (4.1, 3.5), Margins(0.8, 0.35, 0.5, labelled=True)
_COLOURS = {"tissue": "#f2d3c4", "fat": "#fbeeb5", "skin": "#d99a7c"}


def mesh_picture(
    mesh: Mesh, probe: ProbeShape, figures: MeshQuality, path: Path, *, title: str, start_depth: float,
    sides: tuple[str, str],
) -> None:  # fmt: skip
    """Write PNG and SVG. Look for small cells under the probe and correctly placed bones; spikes are a fault.

    sides : sides of the patient towards which x and y point
    """
    across, down = _PANEL_INCHES
    figure, places = panel_sheet([across] * 2, [down] * 2, _MARGINS, title)
    axes: Any = places.subplots()
    draw_cut(axes[0, 0], mesh, probe, axis=1, start_depth=start_depth, sides=sides)
    draw_cut(axes[0, 1], mesh, probe, axis=0, start_depth=start_depth, sides=sides)
    _from_above(axes[1, 0], mesh, probe, sides)
    _histogram(axes[1, 1], mesh, figures)
    save_picture(figure, path, dpi=143)


def draw_cut(
    axes: Any, mesh: Mesh, probe: ProbeShape, *, axis: int, start_depth: float, sides: tuple[str, str]
) -> None:
    """Draw the tetrahedra cut by the plane through the site whose normal is x (0) or y (1)."""
    across = 1 - axis
    for block in mesh.solid_blocks:
        polygons = section(mesh.points, block.cells[:, :4], axis)
        shapes = [each[:, [across, 2]] for each in polygons]
        colour = _COLOURS.get(block.name, "#dddddd")
        axes.add_collection(PolyCollection(shapes, facecolors=colour, edgecolors="#555555", linewidths=0.35))
    half = (probe.length / 2, probe.width / 2)[across]
    u = np.linspace(-half, half, 101)
    rise = probe.rise(u, np.zeros_like(u)) if across == 0 else probe.rise(np.zeros_like(u), u)
    outline = np.vstack([[-half, probe.wall], np.c_[u, rise], [half, probe.wall]]) - [0, start_depth]
    axes.fill(*outline.T, facecolor="#9db4c8", edgecolor="#1f4e79", linewidth=1.2, alpha=0.8)
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel=_axis_words(across, sides), ylabel="z, outward [mm]")
    axes.set_title(f"cut through the site at {'xy'[axis]} = 0; empty inside: bone", fontsize=10)


def section(points: Array, cells: IntArray, axis: int) -> list[Array]:
    """Polygons (k, 3) in which the plane points[axis] = 0 (beside nodes on it) intersects the tetrahedra."""
    height = points[cells, axis] - 1e-6
    cut = (height.min(axis=1) < 0) & (height.max(axis=1) > 0)
    out = []
    for corners, h in zip(points[cells[cut]], height[cut], strict=True):
        below, above = np.flatnonzero(h < 0), np.flatnonzero(h >= 0)
        ends = [corners[i] + h[i] / (h[i] - h[j]) * (corners[j] - corners[i]) for i in below for j in above]
        polygon = np.array(ends)
        if len(polygon) == 4:
            polygon = polygon[[0, 1, 3, 2]]
        out.append(polygon)
    return out


def _axis_words(axis: int, sides: tuple[str, str]) -> str:
    """
    >>> _axis_words(1, ("left", "head"))
    'y, across the probe; + is head [mm]'
    """
    return f"{('x, along', 'y, across')[axis]} the probe; + is {sides[axis]} [mm]"


def _from_above(axes: Any, mesh: Mesh, probe: ProbeShape, sides: tuple[str, str]) -> None:
    """Draw the skin facets that face upward; those within reach of the probe are coloured."""
    for name, colour in (("skin", "#eeeeee"), ("contact", "#f6c9b0")):
        faces = next(iter(mesh.surfaces[name].facets.values()))[:, :3]
        corners = mesh.points[faces]
        up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0
        shapes = PolyCollection(
            list(corners[up][:, :, :2]), facecolors=colour, edgecolors="#666666", linewidths=0.4
        )
        axes.add_collection(shapes)
    axes.add_collection(LineCollection([_outline(probe)], colors="#1f4e79", linewidths=1.8))
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel=_axis_words(0, sides), ylabel=_axis_words(1, sides))
    axes.set_title("skin from outside; shaded: within the probe's reach;\nblue: its outline", fontsize=10)


def _outline(probe: ProbeShape) -> Array:
    a, b = probe.flat
    t = np.linspace(0, np.pi / 2, 13)
    corners = [(a, b, 0.0), (-a, b, 0.5), (-a, -b, 1.0), (a, -b, 1.5)]
    parts = [
        np.c_[x + probe.edge_radius * np.cos(t + q * np.pi), y + probe.edge_radius * np.sin(t + q * np.pi)]
        for x, y, q in corners
    ]
    ring = np.vstack(parts)
    return np.vstack([ring, ring[:1]])


def _histogram(axes: Any, mesh: Mesh, figures: MeshQuality) -> None:
    lowest = [dihedral_angles_deg(mesh.points, each.cells).min(axis=1) for each in mesh.solid_blocks]
    axes.hist(np.concatenate(lowest), bins=np.arange(0, 72, 2), color="#7f9db9", edgecolor="white")
    axes.axvline(4, color="#a33", linewidth=1, linestyle="--", label="4°: required minimum")
    axes.axvline(8, color="#d90", linewidth=1, linestyle="--", label="8°: least under the probe")
    axes.set(xlabel="smallest dihedral angle of a tetrahedron [°]", ylabel="tetrahedra")
    axes.set_ylim(top=1.2 * axes.get_ylim()[1])  # room for the legend above the bars
    axes.legend(frameon=False, loc="upper right")
    axes.set_title(
        f"{figures.n_cells} tetrahedra; smallest angle {figures.min_angle_deg:.1f}°,\n"
        f"under the probe {figures.min_angle_under_probe_deg:.1f}°",
        fontsize=10,
    )


# mm: half length of a line, distance between lines, thickness of the section
_HALF_LENGTH, _SPACING, _SLICE = 2.2, 5.0, 4.0
_FIBRES = "#8c1d18"


def fibre_picture(
    mesh: Mesh, block: Block, axes: Array, probe: ProbeShape, path: Path, *, title: str,
    sides: tuple[str, str],
) -> None:  # fmt: skip
    """Write PNG and SVG: fibres as short lines, as dots where they are perpendicular to the section.

    block, axes (n_cells, 3) : the tissue and the unit fibre direction in each of its cells
    sides : sides of the patient towards which x and y point
    """
    across, down = _FIBRE_PANEL_INCHES
    figure, places = panel_sheet([across] * 2, [down], _FIBRE_MARGINS, title)
    panels: Any = places.subplots()
    middles = mesh.points[block.cells].mean(axis=1)
    for panel, axis in zip(panels, (1, 0), strict=True):
        draw_cut(panel, mesh, probe, axis=axis, start_depth=0.0, sides=sides)
        # draw one line every few millimetres, as long as the fibre's projection on the section
        along = [1 - axis, 2]
        near = np.flatnonzero(np.abs(middles[:, axis]) <= _SLICE)
        spots = middles[near][:, along]
        _, first = np.unique(np.floor(spots / _SPACING), axis=0, return_index=True)
        chosen, at = near[first], spots[first]
        half = _HALF_LENGTH * axes[chosen][:, along]
        lines = np.stack([at - half, at + half], axis=1)
        panel.add_collection(LineCollection(list(lines), colors=_FIBRES, linewidths=1.3))
        panel.plot(*at.T, ".", ms=2.0, color=_FIBRES)
        panel.set_title(f"fibres near the plane {'xy'[axis]} = 0 (a dot: across it)")
    save_picture(figure, path, dpi=143)


def study_picture(
    path: Path, *, sizes: list[tuple[float, float]], margins: list[tuple[float, float]],
    used: tuple[float, float], extrapolation: Extrapolation, depth: float, title: str,
) -> None:  # fmt: skip
    """Plot the force (N) at full depth against edge length and against the margin beyond the probe.

    sizes, margins : (mm, N) pairs; used : (size, margin) of the model itself
    """
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    _curve(left, sizes, used[0], "edge length under the probe [mm]", depth, (extrapolation.limit,))
    left.axhline(extrapolation.limit, color="#777777", linestyle="--", linewidth=1)
    how = "assumed" if extrapolation.order_is_assumed else "seen"
    left.set_title(
        f"dashed: extrapolated to 0 ({extrapolation.limit:.3g} N, order {extrapolation.order:.1f} {how})"
    )
    left.set_xlim(left=0)
    _curve(right, margins, used[1], "tissue kept beyond the probe face [mm]", depth)
    right.set_title("where it is flat, the cut is far enough away")
    put_title(figure, title)
    save_figure(figure, path, dpi=120)


def _curve(
    axes: Any, pairs: list[tuple[float, float]], used: float, label: str, depth: float,
    others: tuple[float, ...] = (0.0,),
) -> None:  # fmt: skip
    """others : further forces (N) that the axis must include"""
    x, force = zip(*sorted(pairs), strict=True)
    axes.plot(x, force, "o-", color="#1f4e79")
    mine = [(a, f) for a, f in pairs if a == used]
    axes.plot(*zip(*mine, strict=True), "o", color="#c8502d", markersize=9, label="the model")
    axes.set(xlabel=label, ylabel=f"force at {depth:.2f} mm [N]", ylim=(0, 1.12 * max(*force, *others)))
    axes.legend(frameon=False)
