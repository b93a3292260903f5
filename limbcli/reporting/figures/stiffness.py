"""The stiffness map on the model: a section through the image plane, coloured by c."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from limbcli.model import Array, IntArray
from limbcli.reporting.figures.section import cut_tetrahedra, linear_tetrahedra, outline
from limbcli.reporting.figures.style import INK, bare, facets, new_figure, style

_COLOURS = {"skin": INK, "bone": "#7a4b12"}


@dataclass(frozen=True, eq=False, kw_only=True)
class StiffnessSection:
    """points (n_points, 3) mm; cells of `kind` with c_kpa (n_cells,); the map's pixels, mm; outlines."""

    points: Array
    kind: str
    cells: IntArray
    c_kpa: Array
    lateral: Array
    depth: Array
    surfaces: dict[str, dict[str, IntArray]] = field(default_factory=dict)


def stiffness_figure(section: StiffnessSection) -> Figure:
    """x-z section at y = 0, before loading: c element by element, and the position of the image."""
    tetrahedra, parent = linear_tetrahedra(section.kind, section.cells)
    cut = cut_tetrahedra(section.points, tetrahedra)
    corners = cut.at(section.points)[:, [0, 2]]
    with style():
        span = np.ptp(corners, axis=0)
        figure = new_figure(6.4, min(max(5.2 * span[1] / span[0], 2.0), 6.0) + 1.6)
        axes = figure.add_subplot()
        values, scale = section.c_kpa[parent[cut.cells]], _range(section.c_kpa)
        drawn = facets(axes, corners[cut.triangles], array=values, cmap="viridis", norm=scale)
        for name, surface in section.surfaces.items():
            lines = list(outline(section.points, surface, section.points))
            axes.add_collection(LineCollection(lines, colors=_COLOURS[name], lw=1.3, label=name))
        (left, right), (top, bottom) = _ends(section.lateral), _ends(-section.depth)
        axes.plot(
            [left, right, right, left, left], [top, top, bottom, bottom, top],
            "--", color="#d0342c", lw=1.4, label="the shear-wave image",
        )  # fmt: skip
        axes.autoscale_view()
        bare(axes)
        axes.set(xlabel="x, along the probe's long side [mm]", ylabel="z, outward along the skin normal [mm]")
        axes.set_title("c = 2ρv² at level 0, element by element")
        figure.colorbar(drawn, ax=axes, label="c [kPa]", shrink=0.9)
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def _range(values: Array) -> Normalize:
    """Limits of the colour scale; a uniform map is placed in its middle."""
    low, high = float(values.min()), float(values.max())
    margin = 0.0 if high - low > 1e-3 * high else 0.05 * high
    return Normalize(low - margin, high + margin)


def _ends(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())
