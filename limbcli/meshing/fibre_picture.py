"""Picture of the fibre directions: two sections through the site with the fibre axes of nearby cells."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection

from limbcli.drawing import Margins, panel_sheet, save_picture
from limbcli.meshing.mesh_picture import draw_cut
from limbcli.meshing.probe import ProbeShape
from limbcli.model import Array, Block, Mesh

# mm: half length of a line, distance between lines, thickness of the section
_HALF_LENGTH, _SPACING, _SLICE = 2.2, 5.0, 4.0
_PANEL_INCHES, _MARGINS = (4.1, 3.5), Margins(0.8, 0.35, 0.5, labelled=True)
_COLOUR = "#8c1d18"


def fibre_picture(
    mesh: Mesh, block: Block, axes: Array, probe: ProbeShape, path: Path, *, title: str,
    sides: tuple[str, str],
) -> None:  # fmt: skip
    """Write PNG and SVG: fibres as short lines, as dots where they are perpendicular to the section.

    block, axes (n_cells, 3) : the tissue and the unit fibre direction in each of its cells
    sides : sides of the patient towards which x and y point
    """
    across, down = _PANEL_INCHES
    figure, places = panel_sheet([across] * 2, [down], _MARGINS, title)
    panels: Any = places.subplots()
    middles = mesh.points[block.cells].mean(axis=1)
    for panel, axis in zip(panels, (1, 0), strict=True):
        draw_cut(panel, mesh, probe, axis=axis, start_depth=0.0, sides=sides)
        _draw_axes(panel, middles, axes, axis)
        panel.set_title(f"fibres near the plane {'xy'[axis]} = 0 (a dot: across it)")
    save_picture(figure, path, dpi=143)


def _draw_axes(panel: Any, middles: Array, axes: Array, axis: int) -> None:
    """Draw one line every few millimetres, as long as the fibre's projection on the section."""
    across = 1 - axis
    near = np.flatnonzero(np.abs(middles[:, axis]) <= _SLICE)
    places = middles[near][:, [across, 2]]
    _, first = np.unique(np.floor(places / _SPACING), axis=0, return_index=True)
    chosen, at = near[first], places[first]
    half = _HALF_LENGTH * axes[chosen][:, [across, 2]]
    lines = np.stack([at - half, at + half], axis=1)
    panel.add_collection(LineCollection(list(lines), colors=_COLOUR, linewidths=1.3))
    panel.plot(*at.T, ".", ms=2.0, color=_COLOUR)
