"""Pressure and shear of each named patch, as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.files.plain_text import write_rows
from limbcli.model import Array, LimbModel
from limbcli.numbers.units import kpa_from_mpa
from limbcli.sockets.donning import SocketState
from limbcli.stages.in_socket.limb_in_socket import PATCH
from limbcli.stages.in_socket.patch_pressure import PatchPressure

WHOLE = "skin"  # name of the row of the whole skin
QUANTITIES = ("contact_area_mm2", "mean_kpa", "p95_kpa", "peak_kpa", "mean_shear_kpa", "peak_shear_kpa")


Interval = tuple[float, float]


def patch_masks(limb: LimbModel) -> dict[str, NDArray[np.bool_]]:
    """By patch, which facets (n_facets,) of the skin belong to it; last the whole skin."""
    skin = next(iter(limb.mesh.surfaces["skin"].facets.values()))
    rows = {tuple(sorted(each)): k for k, each in enumerate(skin[:, :3].tolist())}
    masks = {}
    for name, surface in limb.mesh.surfaces.items():
        if name.startswith(PATCH):
            mask = np.zeros(len(skin), bool)
            own = next(iter(surface.facets.values()))[:, :3].tolist()
            mask[[rows[tuple(sorted(each))] for each in own]] = True
            masks[name.removeprefix(PATCH)] = mask
    return {**masks, WHOLE: np.ones(len(skin), bool)}


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
