"""The deformed model as an interactive 3-D scene of the page: points, displacements and facets in a compact
encoding."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from limbcli.model import Array, IntArray
from limbcli.reporting.figures.deformed import DISPLACEMENT_MAP, DeformedState
from limbcli.reporting.figures.section import cut_tetrahedra, linear_tetrahedra, linear_triangles

_STEPS = 32000  # integer steps of a coordinate over the size of the scene, stored in two bytes
_COLOURS = 64
_SHARES = 65535  # integer steps of a value
_LARGEST = 0.99  # share of the points in contact within the scale: single points at edges do not set it
PRESSURE_MAP, FREE_SKIN = "viridis", "#e6e0dc"
_CORNERS = {"tri3": 3, "tri6": 3, "quad4": 4, "quad8": 4, "tet4": 4, "tet10": 4, "hex8": 8, "penta6": 6}
_BOUNDARY = {3: ((0, 1), (1, 2), (2, 0)), 4: ((0, 1), (1, 2), (2, 3), (3, 0))}


@dataclass(frozen=True, eq=False)
class ScenePart:
    """Undeformed points (n, 3) mm, their displacement (n, 3) mm, triangles (m, 3) and edges (k, 2) to draw.

    coloured : by the magnitude of the displacement, or by `values`; else in a single colour
    values (n,) : shares of the scale, from 0 to 1; None: the displacement
    """

    name: str
    points: Array
    displacement: Array
    triangles: IntArray
    edges: IntArray
    coloured: bool = True
    values: Array | None = None


def pressure_scene(
    points: Array, displacement: Array, triangles: IntArray, pressure_kpa: Array
) -> dict[str, Any]:
    """Skin coloured by pressure (n,), kPa; NaN and 0: no contact. The scale ends at its 99th percentile."""
    pressure = np.nan_to_num(pressure_kpa)
    touching = pressure > 0
    most = float(np.quantile(pressure[touching], _LARGEST)) if touching.any() else 1.0
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    values = np.clip(pressure / most, 0.0, 1.0)
    part = ScenePart("skin", points, displacement, triangles, edges, values=values)
    colours = colormaps[PRESSURE_MAP](np.linspace(0, 1, _COLOURS))[:, :3]
    colours[0] = to_rgb(FREE_SKIN)
    largest = float(np.linalg.norm(displacement, axis=1).max(initial=0.0))
    return {**_scene([part], colours), "field_kpa": most, "moved_mm": largest}


def scene_of(state: DeformedState) -> dict[str, Any]:
    """Input of the page's script: base64-encoded parts, the range of the field, and its colours.

    Coordinates are integer multiples of `step_mm` from `origin_mm`; displacements are multiples of
    `displacement_step_mm`.
    """
    parts = [each for each in _parts(state) if len(each.triangles)]
    field = max(float(np.linalg.norm(p.displacement, axis=1).max(initial=0.0)) for p in parts if p.coloured)
    colours = colormaps[DISPLACEMENT_MAP](np.linspace(0, 1, _COLOURS))[:, :3]
    return {**_scene(parts, colours), "field_mm": field, "depth_mm": float(state.depth)}


def _scene(parts: Sequence[ScenePart], colours: Array) -> dict[str, Any]:
    every = np.concatenate([each.points for each in parts])
    low, high = every.min(axis=0), every.max(axis=0)
    step = float((high - low).max() / _STEPS) or 1.0
    most = max(float(np.abs(each.displacement).max(initial=0.0)) for each in parts)
    small = most / _STEPS or 1.0
    middle = 0.5 * (low + high)
    return {
        "origin_mm": [float(each) for each in middle],
        "radius_mm": float(np.linalg.norm(high - low) / 2),
        "step_mm": step,
        "displacement_step_mm": small,
        "colours": _packed((colours * 255).astype("u1")),
        "parts": [
            {
                "name": each.name,
                "coloured": each.coloured,
                "points": _packed(np.round((each.points - middle) / step).astype("<i2")),
                "displacement": _packed(np.round(each.displacement / small).astype("<i2")),
                "triangles": _packed(each.triangles.astype("<u4")),
                "edges": _packed(each.edges.astype("<u4")),
                **({} if each.values is None else {"values": _packed((each.values * _SHARES).astype("<u2"))}),
            }
            for each in parts
        ],
    }


def _parts(state: DeformedState) -> list[ScenePart]:
    u = state.displacement
    rigid = np.broadcast_to(state.probe_shift, u.shape)
    return [
        _surface("skin", state.skin, state.points, u),
        _surface("cut faces", state.cut, state.points, u),
        _surface("bone", state.bone, state.points, u, coloured=False),
        _section(state),
        _surface("probe", state.probe, state.points, rigid, coloured=False),
    ]


def _surface(
    name: str, facets: dict[str, IntArray], points: Array, displacement: Array, *, coloured: bool = True
) -> ScenePart:
    """Facets whose corners are all known; the edges are those of the elements, not of the triangles drawn."""
    triangles, edges = [np.zeros((0, 3), np.int64)], [np.zeros((0, 2), np.int64)]
    for kind, each in facets.items():
        known = each[np.isfinite(displacement[each]).all(axis=(1, 2))]
        triangles.append(linear_triangles(kind, known))
        pairs = np.array(_BOUNDARY[_CORNERS[kind]])
        edges.append(known[:, pairs].reshape(-1, 2))
    faces, lines = np.concatenate(triangles), np.concatenate(edges)
    lines = np.unique(np.sort(lines, axis=1), axis=0)
    used, numbers = np.unique(np.concatenate([faces.ravel(), lines.ravel()]), return_inverse=True)
    n = faces.size
    return ScenePart(
        name, points[used], displacement[used], numbers[:n].reshape(-1, 3), numbers[n:].reshape(-1, 2),
        coloured,
    )  # fmt: skip


def _section(state: DeformedState) -> ScenePart:
    """The cut through the probe's middle plane (y = 0), which shows the inside."""
    tetrahedra, _ = linear_tetrahedra(state.kind, state.cells)
    cut = cut_tetrahedra(state.points, tetrahedra)
    points, displacement = cut.at(state.points), cut.at(state.displacement)
    known = np.isfinite(displacement[cut.triangles]).all(axis=(1, 2))
    triangles = cut.triangles[known]
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return ScenePart("section", points, np.nan_to_num(displacement), triangles, np.unique(edges, axis=0))


def _packed(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
