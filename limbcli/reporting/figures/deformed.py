"""The deformed model: a section through the probe's middle plane."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation

from limbcli.model import Array, IntArray
from limbcli.reporting.figures.section import cut_tetrahedra, linear_tetrahedra, outline
from limbcli.reporting.figures.style import INK, QUIET, bare, facets, legend_below, new_figure, style

DISPLACEMENT_MAP, STRAIN_MAP = "YlGnBu", "YlOrRd"
UNKNOWN = "#dfe4e8"
BONE = "#7a4b12"


@dataclass(frozen=True, eq=False, kw_only=True)
class DeformedState:
    """Model of a site at the deepest level.

    points, displacement : (n_points, 3) mm, model frame; NaN where nothing was recorded
    kind, cells : the tissue's cells
    skin, bone, probe, cut : facets by kind
    probe_shift : (3,) displacement of the rigid probe (mm)
    stretch : (n_cells,) smallest principal stretch, NaN where not recorded; or None
    sides : patient's sides to which x and y point; None if unknown
    """

    points: Array
    displacement: Array
    kind: str
    cells: IntArray
    skin: dict[str, IntArray]
    bone: dict[str, IntArray]
    probe: dict[str, IntArray]
    probe_shift: Array
    depth: float
    stretch: Array | None = None
    cut: dict[str, IntArray] = field(default_factory=dict)
    sides: tuple[str, str] | None = None


def section_figure(state: DeformedState) -> Figure:
    """x-z section at y = 0: displacement magnitude, and shortening if the run recorded it."""
    with_stretch = state.stretch is not None and bool(np.isfinite(state.stretch).any())
    with style():
        span = _span(state)
        width = 3.3 if with_stretch else 5.0
        figure = new_figure(7.6 if with_stretch else 5.8, min(width * span[2] / span[0], 6.0) + 2.1)
        panels = figure.subplots(1, 2 if with_stretch else 1, sharey=True, squeeze=False)[0]
        _displacement_panel(panels[0], state)
        if with_stretch:
            _shortening_panel(panels[1], state)
        for axes in panels:
            _outlines(axes, state)
            bare(axes)
            towards = "" if state.sides is None else f"\n(+ is {state.sides[0]})"
            axes.set(xlabel=f"x, along the probe's long side [mm]{towards}")
        panels[0].set(ylabel="z, outward along the skin normal [mm]")
        lacking = with_stretch and state.stretch is not None and not np.isfinite(state.stretch).all()
        legend_below(figure, panels[0], *[Patch(facecolor=UNKNOWN, label="not recorded")] * lacking)
    return figure


def _span(state: DeformedState) -> Array:
    """Size (3,) of what a section shows (mm): the tissue, and the probe in its final position."""
    probe = [each.ravel() for each in state.probe.values()]
    shown = [state.points[np.unique(state.cells)]]
    shown += [state.points[np.unique(each)] + state.probe_shift for each in probe]
    return np.asarray(np.ptp(np.concatenate(shown), axis=0))


def _displacement_panel(axes: Axes, state: DeformedState) -> None:
    tetrahedra, _ = linear_tetrahedra(state.kind, state.cells)
    cut = cut_tetrahedra(state.points, tetrahedra)
    moved = cut.at(state.points + state.displacement)
    size = cut.at(np.linalg.norm(state.displacement, axis=1))
    whole = np.isfinite(size[cut.triangles]).all(axis=1)
    size = np.nan_to_num(size)
    mesh = Triangulation(np.nan_to_num(moved[:, 0]), np.nan_to_num(moved[:, 2]), cut.triangles[whole])
    drawn = axes.tripcolor(mesh, size, shading="gouraud", cmap=DISPLACEMENT_MAP, vmin=0.0, rasterized=True)
    _bar(axes, drawn, "displacement [mm]")
    axes.set_title("how far the tissue moves")


def _shortening_panel(axes: Axes, state: DeformedState) -> None:
    assert state.stretch is not None
    tetrahedra, parent = linear_tetrahedra(state.kind, state.cells)
    cut = cut_tetrahedra(state.points, tetrahedra)
    moved = cut.at(state.points + state.displacement)
    percent = 100.0 * (1.0 - state.stretch[parent[cut.cells]])
    known = np.isfinite(percent) & np.isfinite(moved[cut.triangles]).all(axis=(1, 2))
    top = max(float(np.percentile(percent[known], 99.5)), 1e-6) if known.any() else 1.0
    corners = moved[:, [0, 2]][cut.triangles]
    facets(axes, corners[~known], facecolors=UNKNOWN, rasterized=False)
    drawn = facets(axes, corners[known], array=percent[known], cmap=STRAIN_MAP, norm=Normalize(0.0, top))
    _bar(axes, drawn, "largest shortening [%], element by element")
    axes.set_title("how much it is compressed")


def _bar(axes: Axes, drawn: ScalarMappable, label: str) -> None:
    axes.figure.colorbar(drawn, ax=axes, label=label, location="bottom", shrink=0.9, pad=0.02)


def _outlines(axes: Axes, state: DeformedState) -> None:
    """Undeformed (dashed) and deformed skin, bone, and the probe in its final position."""
    for surface, values, colour, dashes, label in (
        (state.skin, state.points, QUIET, "--", "skin before"),
        (state.skin, state.points + state.displacement, INK, "-", "skin now"),
        (state.bone, state.points, BONE, "-", "bone"),
        (state.probe, state.points + state.probe_shift, "#d0342c", "-", "probe"),
    ):
        lines = outline(state.points, surface, values)
        if len(lines):
            axes.add_collection(
                LineCollection(list(lines), colors=colour, linestyles=dashes, linewidths=1.3, label=label)
            )
