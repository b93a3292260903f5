"""Pressure and shear on the skin: of each named patch as a table, and as a picture from all sides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from limbcli.drawing import put_title, save_picture
from limbcli.files.plain_text import write_rows
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array, LimbModel
from limbcli.numbers.units import kpa_from_mpa
from limbcli.reporting.figures.style import facets
from limbcli.sockets.donning import SocketState
from limbcli.stages.in_socket.intervals import QUANTITIES, WHOLE, Interval, PatchPressure
from limbcli.stages.in_socket.limb_in_socket import LimbInSocket, facets_of_patches, lateral_of


def patch_masks(limb: LimbModel) -> dict[str, NDArray[np.bool_]]:
    """By patch, which facets (n_facets,) of the skin belong to it; last the whole skin."""
    masks = facets_of_patches(limb)
    n_facets = sum(map(len, limb.mesh.surfaces["skin"].facets.values()))
    return {**masks, WHOLE: np.ones(n_facets, bool)}


def patch_rows(
    states: Sequence[SocketState], masks: Mapping[str, NDArray[np.bool_]], areas: Array
) -> list[PatchPressure]:
    """One row per state and patch. areas (n_facets,) : at rest, mm2"""
    rows = []
    for state in states:
        for name, mask in masks.items():
            pressure, shear, size = (
                each[mask] for each in (state.facet_pressure_mpa, state.facet_shear_mpa, state.facet_area_mm2)
            )
            touching = pressure > 0
            weight = size[touching]
            rows.append(PatchPressure(
                load_n=state.load_n, patch=name,
                area_mm2=float(areas[mask].sum()), contact_area_mm2=float(weight.sum()),
                mean_kpa=_mean(pressure[touching], weight),
                p95_kpa=_quantile(pressure[touching], weight, 0.95),
                peak_kpa=kpa_from_mpa(float(pressure.max(initial=0.0))),
                mean_shear_kpa=_mean(shear[touching], weight),
                peak_shear_kpa=kpa_from_mpa(float(shear.max(initial=0.0))),
            ))  # fmt: skip
    return rows


def _mean(values: Array, weight: Array) -> float:
    return kpa_from_mpa(float(np.average(values, weights=weight))) if len(values) else 0.0


def _quantile(values: Array, weight: Array, share: float) -> float:
    """The value (kPa) below which this share of the area lies."""
    if not len(values):
        return 0.0
    order = np.argsort(values)
    reached = np.cumsum(weight[order]) / weight.sum()
    return kpa_from_mpa(float(values[order][np.searchsorted(reached, share - 1e-12)]))


def write_patches(
    path: Path, rows: Sequence[PatchPressure], intervals: Mapping[tuple[float, str, str], Interval]
) -> None:
    """Write patches.csv; intervals : 95 %, by (load, patch, quantity); the columns are empty without."""
    own = [each.name for each in fields(PatchPressure)]
    ends = [f"{name}_{end}" for name in QUANTITIES for end in ("low", "high")]
    cells = []
    for row in rows:
        values = [f"{each:.6g}" if isinstance(each, float) else each for each in vars(row).values()]
        found = [intervals.get((row.load_n, row.patch, name)) for name in QUANTITIES]
        cells.append([*values, *(f"{x:.6g}" if each else "" for each in found for x in each or (0, 0))])
    write_rows(path, [*own, *ends], cells)


_FREE = "#e6e0dc"  # skin without contact
_UP, _FRONT = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
_LARGEST = 0.99  # share of the facets in contact within the scale: single facets at edges do not set it


def pressure_picture(path: Path, together: LimbInSocket, pressure_kpa: Array, title: str) -> None:
    """Write PNG and SVG. pressure_kpa (n_facets,) : mean over each facet of the skin

    Look for pressure that spreads over patches that bear load; bad is a rim of high pressure along the brim
    or the proximal cut, or pressure on single facets.
    """
    skin, touching = together.skin, pressure_kpa > 0
    most = float(np.quantile(pressure_kpa[touching], _LARGEST)) if touching.any() else 1.0
    scale = Normalize(0.0, max(most, 1e-3))
    lateral = lateral_of(together.frame)
    figure = Figure(figsize=(14, 6.4), layout="constrained")
    axes = figure.subplots(1, 5, gridspec_kw={"width_ratios": [1, 1, 1, 1, 2]})
    views = (
        ("from the front", _FRONT), ("from the lateral side", lateral), ("from behind", -_FRONT),
        ("from the medial side", -lateral),
    )  # fmt: skip
    for each, (words, towards) in zip(axes, views, strict=False):
        _view(each, skin, pressure_kpa, towards, scale)
        each.set_title(words, fontsize=10)
    drawn = _unrolled(axes[4], skin, pressure_kpa, lateral, scale)
    axes[0].set_ylabel("height above the distal end [mm]")
    figure.colorbar(drawn, ax=axes.tolist(), label="pressure [kPa]", extend="max", fraction=0.02)
    put_title(figure, title)
    save_picture(figure, path, dpi=110)


def _collection(
    axes: Any, plan: Array, pressure: Array, scale: Normalize, order: NDArray[np.int64]
) -> PolyCollection:
    drawn = facets(axes, plan[order], cmap="viridis", norm=scale, rasterized=False)
    drawn.set_array(np.ma.masked_less_equal(pressure[order], 0.0))
    drawn.cmap = drawn.cmap.with_extremes(bad=_FREE)
    return drawn


def _view(axes: Any, skin: Triangles, pressure: Array, towards: Array, scale: Normalize) -> None:
    """The facets that face the viewer, the farthest first."""
    right = np.cross(_UP, towards)
    shown = np.flatnonzero(skin.area_vectors @ towards > 0)
    order = shown[np.argsort(skin.centroids[shown] @ towards)]
    _collection(axes, np.stack([skin.corners @ right, skin.corners @ _UP], axis=-1), pressure, scale, order)
    axes.set_aspect("equal")
    axes.set_xlabel("across [mm]")


def _unrolled(
    axes: Any, skin: Triangles, pressure: Array, lateral: Array, scale: Normalize
) -> PolyCollection:
    """Angle from the front, positive towards the lateral side; facets across the back are left out."""
    middle = np.average(skin.centroids, axis=0, weights=skin.areas)
    away = skin.corners - middle
    angle = np.degrees(np.arctan2(away @ lateral, away @ _FRONT))
    whole = np.flatnonzero(np.ptp(angle, axis=1) < 180.0)
    drawn = _collection(axes, np.stack([angle, skin.corners @ _UP], axis=-1), pressure, scale, whole)
    axes.set_xlabel("angle from the front, lateral positive [deg]")
    axes.set_ylabel("height [mm]")
    axes.set_title("unrolled", fontsize=10)
    return drawn
