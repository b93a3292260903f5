"""The deformed skin, seen from outside."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure

from limbcli.model import Array, IntArray
from limbcli.reporting.figures.deformed import DISPLACEMENT_MAP, UNKNOWN, DeformedState
from limbcli.reporting.figures.section import linear_triangles
from limbcli.reporting.figures.style import INK, bare, new_figure, style


def skin_figure(state: DeformedState) -> Figure:
    """The deformed skin in a slanted view, coloured by how far it moved along z."""
    moved = state.points + state.displacement
    skin, cut = _triangles(state.skin, moved), _triangles(state.cut, moved)
    facets = np.concatenate([skin, cut])
    seen, depth_order, shade = _view(moved, facets)
    colour = -state.displacement[skin, 2].mean(axis=1)
    with style():
        figure = new_figure(7.4, 4.6)
        axes = figure.subplots()
        norm = Normalize(min(0.0, float(colour.min())), max(float(colour.max()), 1e-6))
        palette = ScalarMappable(norm, DISPLACEMENT_MAP)
        rgba = np.concatenate([palette.to_rgba(colour), np.tile(to_rgba(UNKNOWN), (len(cut), 1))])
        rgba[: len(skin), :3] *= shade[: len(skin), None]
        drawn = PolyCollection(
            seen[facets][depth_order], facecolors=rgba[depth_order], edgecolors="face", linewidths=0.2
        )
        drawn.set_rasterized(True)
        axes.add_collection(drawn)
        axes.autoscale_view()
        bare(axes)
        axes.set_axis_off()
        _scale_bar(axes, 20.0)
        figure.colorbar(palette, ax=axes, label="skin moved inwards [mm]", shrink=0.75)
    return figure


def _view(points: Array, facets: IntArray) -> tuple[Array, IntArray, Array]:
    """Parallel projection from above and beside: picture coordinates, far-to-near order, brightness."""
    turn, tilt = np.radians(-35.0), np.radians(48.0)
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]])
    seen = np.nan_to_num(points) @ (about_x @ about_z).T
    # Viewer looks along -(third axis of the turned frame); picture is (right, up).
    picture = seen[:, :2]
    depth = seen[facets, 2].mean(axis=1)
    corners = seen[facets]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    light = np.array([-0.35, 0.55, 0.76])
    shade = 0.55 + 0.45 * np.clip(normal @ light, 0.0, 1.0)
    return picture, np.argsort(depth), shade


def _scale_bar(axes: Axes, length: float) -> None:
    low, high = axes.get_xlim()[0], axes.get_ylim()[0]
    axes.plot([low, low + length], [high, high], color=INK, lw=2.5, solid_capstyle="butt")
    axes.annotate(f"{length:g} mm", (low + length / 2, high), (0, 4), textcoords="offset points", ha="center")


def _triangles(facets: dict[str, IntArray], points: Array) -> IntArray:
    """Linear facets whose corners are all known."""
    parts = [linear_triangles(kind, each) for kind, each in facets.items()]
    every = np.concatenate(parts) if parts else np.zeros((0, 3), dtype=np.int64)
    return every[np.isfinite(points[every]).all(axis=(1, 2))]
