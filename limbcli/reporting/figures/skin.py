"""Outside view of the deformed skin."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from limbcli.model import Array, IntArray
from limbcli.reporting.figures.deformed import BONE, DISPLACEMENT_MAP, UNKNOWN, DeformedState
from limbcli.reporting.figures.section import linear_triangles
from limbcli.reporting.figures.style import INK, bare, facets, new_figure, style

_ARROW = 14.0  # length of an arrow (mm)


def skin_figure(state: DeformedState) -> Figure:
    """The deformed skin in an oblique view, coloured by its displacement along z; bone in the cuts."""
    moved = state.points + state.displacement
    skin, cut, bone = (_triangles(each, moved) for each in (state.skin, state.cut, state.bone))
    shown = np.concatenate([skin, cut, bone])
    seen, depth_order, shade = _view(moved, shown)
    colour = -state.displacement[skin, 2].mean(axis=1)
    with style():
        figure = new_figure(7.4, 4.6)
        axes = figure.subplots()
        norm = Normalize(min(0.0, float(colour.min())), max(float(colour.max()), 1e-6))
        palette = ScalarMappable(norm, DISPLACEMENT_MAP)
        plain = [np.tile(to_rgba(each), (len(at), 1)) for each, at in ((UNKNOWN, cut), (BONE, bone))]
        rgba = np.concatenate([palette.to_rgba(colour), *plain])
        rgba[: len(skin), :3] *= shade[: len(skin), None]
        facets(axes, seen[shown][depth_order], facecolors=rgba[depth_order])
        bare(axes)
        axes.set_axis_off()
        low, high = axes.get_xlim()[0], axes.get_ylim()[0]
        axes.plot([low, low + 20.0], [high, high], color=INK, lw=2.5, solid_capstyle="butt")
        axes.annotate("20 mm", (low + 10.0, high), (0, 4), textcoords="offset points", ha="center")
        if state.sides is not None:
            _label_sides(axes, state.sides)
        marks = [
            Patch(facecolor=each, edgecolor="none", label=word)
            for each, word, at in ((UNKNOWN, "cut open", cut), (BONE, "bone", bone))
            if len(at)
        ]
        if marks:
            figure.legend(handles=marks, loc="outside lower center", ncols=len(marks))
        figure.colorbar(palette, ax=axes, label="skin moved inwards [mm]", shrink=0.75)
    return figure


def _view(points: Array, facets: IntArray) -> tuple[Array, IntArray, Array]:
    """Parallel projection from above and the side: picture coordinates, far-to-near order, brightness."""
    seen = np.nan_to_num(points) @ _turned().T
    # The viewer looks along the negative third axis of the rotated frame; the picture's axes are (right, up).
    picture = seen[:, :2]
    depth = seen[facets, 2].mean(axis=1)
    corners = seen[facets]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    light = np.array([-0.35, 0.55, 0.76])
    shade = 0.55 + 0.45 * np.clip(normal @ light, 0.0, 1.0)
    return picture, np.argsort(depth), shade


def _turned() -> Array:
    """Rotation (3, 3) of the view: rows point right and up in the picture, and towards the viewer."""
    turn, tilt = np.radians(-35.0), np.radians(48.0)
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]])
    return np.asarray(about_x @ about_z)


def _label_sides(axes: Axes, sides: tuple[str, str]) -> None:
    """Draw two arrows beside the limb, along x and y, labelled with the patient's sides they point to."""
    low, high = axes.get_xlim()[0], axes.get_ylim()[1]
    for word, direction in zip(sides, _turned()[:2, :2].T, strict=True):
        right, up = (_ARROW * float(each) for each in direction)
        start = (low + _ARROW, high - 1.6 * _ARROW)
        tip = (start[0] + right, start[1] + up)
        axes.annotate("", tip, start, arrowprops={"arrowstyle": "->", "color": INK, "lw": 1.3})
        axes.annotate(
            word, tip, (6, 6 if up > 0 else -6), textcoords="offset points", fontsize=8.5,
            va="bottom" if up > 0 else "top",
        )  # fmt: skip


def _triangles(facets: dict[str, IntArray], points: Array) -> IntArray:
    """Linear facets whose corners all have known positions."""
    parts = [linear_triangles(kind, each) for kind, each in facets.items()]
    every = np.concatenate(parts) if parts else np.zeros((0, 3), dtype=np.int64)
    return every[np.isfinite(points[every]).all(axis=(1, 2))]
