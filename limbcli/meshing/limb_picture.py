"""A limb's skin from four sides with its named patches."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from limbcli.drawing import put_title, save_picture
from limbcli.meshing.limb_parts import PATCHES, LimbFrame, LimbParts
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

# colours that stay apart for colour-blind readers (Okabe and Ito's set)
_COLOURS = ("#0072b2", "#d55e00", "#cc79a7", "#f0e442", "#009e73", "#56b4e9")
_SKIN = "#ead8cc"


def limb_picture(
    path: Path, frame: LimbFrame, skin: Triangles, parts: LimbParts, *,
    sites: Mapping[str, Array] | None = None, title: str,
) -> None:  # fmt: skip
    """Write PNG and SVG: the limb from the front, its lateral side, the back and its medial side.

    Look for patches over their bones; bad is one on the wrong side, or a limb that stands on its head.
    """
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    views = (
        ("from the front", frame.anterior), ("from the lateral side", frame.lateral),
        ("from behind", -frame.anterior), ("from the medial side", -frame.lateral),
    )  # fmt: skip
    axes = figure.subplots(1, len(views), sharey=True)
    for each, (words, towards) in zip(axes, views, strict=True):
        _view(each, frame, skin, parts, towards, sites or {})
        each.set_title(words, fontsize=10)
    axes[0].set_ylabel("height above the distal end [mm]")
    colours = dict(zip(PATCHES, _COLOURS, strict=True))
    handles = [Patch(color=colours[name], label=name.replace("_", " ")) for name in parts.patches]
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    put_title(figure, title)
    save_picture(figure, path, dpi=120)


def _view(
    axes: Any, frame: LimbFrame, skin: Triangles, parts: LimbParts, towards: Array, sites: Mapping[str, Array]
) -> None:
    """The facets that face the viewer, the farthest first."""
    right = np.cross(frame.axis, towards)
    unit = skin.area_vectors / np.maximum(skin.areas, 1e-12)[:, None]
    facing = unit @ towards
    colours = np.full(len(skin.faces), _SKIN, dtype=object)
    for name, mask in parts.patches.items():
        colours[mask] = _COLOURS[PATCHES.index(name)]
    shown = np.flatnonzero(facing > 0)
    shown = shown[np.argsort(skin.centroids[shown] @ towards)]
    corners = skin.corners[shown] - frame.origin
    plan = np.stack([corners @ right, corners @ frame.axis], axis=-1)
    shade = 0.55 + 0.45 * facing[shown]
    rgb = np.array([[int(c[k : k + 2], 16) / 255 for k in (1, 3, 5)] for c in colours[shown]])
    drawn = PolyCollection(
        list(plan), facecolors=rgb * shade[:, None], edgecolors="#00000030", linewidths=0.2
    )
    axes.add_collection(drawn)
    for name, point in sites.items():
        u, v = (point - frame.origin) @ right, (point - frame.origin) @ frame.axis
        near = np.argmin(np.linalg.norm(skin.centroids - point, axis=1))
        if facing[near] > 0:
            axes.plot([u], [v], "k+", markersize=8)
            axes.annotate(name, (u, v), textcoords="offset points", xytext=(4, 4), fontsize=8)
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel="across [mm]")
