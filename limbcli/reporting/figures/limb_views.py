"""The limb's skin from one of four sides of the patient, and a site's place on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import TriMesh
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.tri import Triangulation

from limbcli.model import Array, IntArray
from limbcli.model.patient_frame import side_of
from limbcli.reporting.figures.style import BLUE, INK, bare, literal, new_figure, style

_HEIGHT, _NARROWEST, _WIDEST = 3.2, 1.3, 3.6  # inches
_ROUND = 8.0  # mm, margin around the limb


@dataclass(frozen=True)
class View:
    """A side from which the limb is seen: axis of LPS across the picture and towards the viewer, with signs.

    z (head) points up.
    """

    name: str
    across: tuple[int, float]
    towards: tuple[int, float]

    def flat(self, points: Array) -> Array:
        """Points (n, 3) in the picture (n, 2): the coordinate across, as it is in LPS, and z."""
        return np.asarray(points, float)[:, [self.across[0], 2]]


VIEWS = (
    View("from the front (anterior)", (0, 1.0), (1, -1.0)),
    View("from the patient's left", (1, 1.0), (0, 1.0)),
    View("from the back (posterior)", (0, -1.0), (1, 1.0)),
    View("from the patient's right", (1, -1.0), (0, -1.0)),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class LimbPlace:
    """A site on its limb, "left" or "right"; mm, patient LPS.

    points (n, 3), triangles (k, 3) : the skin
    place (3,), outward (3,) : the site, and the direction away from the limb there
    face (4, 3) : corners of the probe's face; None if its direction is not known yet
    """

    name: str
    limb: str
    points: Array
    triangles: IntArray
    place: Array
    outward: Array
    face: Array | None = None

    @property
    def view(self) -> View:
        """The view that the site faces."""
        return max(VIEWS, key=lambda each: each.towards[1] * self.outward[each.towards[0]])

    @property
    def words(self) -> str:
        """
        >>> skin = np.array([[0.0, 0, -50], [9, 0, 10], [0, 9, 10]])
        >>> LimbPlace(
        ...     name="p1", limb="left", points=skin, triangles=np.array([[0, 1, 2]]), place=np.zeros(3),
        ...     outward=np.array([0.6, 1.0, 0.4]),
        ... ).words
        'posterior and lateral, 50 mm above the lower end of the limb in the images'
        """
        height = float(self.place[2] - self.points[:, 2].min())
        side = side_of(self.outward * [1.0, 1.0, 0.0])
        for name in ("left", "right"):
            side = side.replace(name, "lateral" if name == self.limb else "medial")
        return f"{side}, {height:.0f} mm above the lower end of the limb in the images"


def draw_skin(axes: Axes, points: Array, triangles: IntArray, view: View) -> None:
    """Draw the facets that face the viewer, with interpolated shading, far ones first."""
    axis, sign = view.towards
    corners = points[triangles]
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at_corners = np.zeros_like(points)
    np.add.at(at_corners, triangles.ravel(), np.repeat(areas, 3, axis=0))
    at_corners /= np.maximum(np.linalg.norm(at_corners, axis=1, keepdims=True), 1e-12)
    seen = np.flatnonzero(sign * areas[:, axis] > 0)
    depth = sign * corners[seen].mean(axis=1)[:, axis]
    grey = np.clip(0.35 + 0.6 * sign * at_corners[:, axis], 0.0, 1.0)
    x, z = view.flat(points).T
    plan = Triangulation(x, z, triangles[seen[np.argsort(depth)]])
    colours = np.stack([grey, 0.93 * grey, 0.88 * grey], axis=1)
    axes.add_collection(TriMesh(plan, facecolors=colours, rasterized=True), autolim=False)


def limb_place_figure(limb: LimbPlace) -> Figure:
    """The limb from the side that the site faces, with the probe's face on it."""
    view, (axis, sign) = limb.view, limb.view.across
    low, high = limb.points.min(axis=0) - _ROUND, limb.points.max(axis=0) + _ROUND
    width = float(np.clip(_HEIGHT * (high[axis] - low[axis]) / (high[2] - low[2]), _NARROWEST, _WIDEST))
    with style():
        figure = new_figure(width, _HEIGHT)
        axes = figure.subplots()
        draw_skin(axes, limb.points, limb.triangles, view)
        if limb.face is not None:
            face = view.flat(limb.face)
            axes.add_patch(Polygon(face, closed=True, fc=BLUE, zorder=3))
            axes.plot(*face[[0, 1, 2, 3, 0]].T, color="white", lw=1.0, zorder=3, label=literal(limb.name))
        else:
            x, z = view.flat(limb.place[None])[0]
            axes.plot([x], [z], "X", color=BLUE, markersize=9, zorder=3, label=literal(limb.name))
        axes.annotate(
            literal(limb.name), view.flat(limb.place[None])[0], xytext=(0, 9), textcoords="offset points",
            ha="center", color=BLUE, fontweight="bold", fontsize=10, zorder=4,
            bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.85},
        )  # fmt: skip
        across = np.eye(3)[axis] * sign
        for at, direction in ((0.0, -across), (1.0, across)):
            axes.text(
                at, 0.0, side_of(direction)[0].upper(), transform=axes.transAxes, color=INK, fontsize=10,
                ha="left" if at == 0 else "right", va="bottom", fontweight="bold",
            )  # fmt: skip
        axes.set(
            xlim=(low[axis], high[axis]) if sign > 0 else (high[axis], low[axis]), ylim=(low[2], high[2])
        )
        axes.set(xlabel=f"{'xyz'[axis]} [mm], patient LPS", ylabel="z [mm], patient LPS")  # for the CSV
        bare(axes)
        axes.set_axis_off()
        axes.set_title(view.name, fontsize=8, fontweight="normal", loc="center")
    return figure
