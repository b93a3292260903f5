"""Shear-wave speed under the probe at simulated levels: maps as the scanner would show, and their means."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import MeasurementError
from limbcli.materials.acoustic import acoustic_tensor
from limbcli.measurement.acoustoelasticity import (
    MAX_TERMS,
    OgdenTerms,
    shear_speed_m_per_s,
    wave_speed_m_per_s,
)
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.swe_prediction import Window, predict_map
from limbcli.model import Array, ElementMap, IntArray, LimbModel, Material
from limbcli.solvers.base import Simulation, Table

_GRADIENT = ("Fxx", "Fxy", "Fxz", "Fyx", "Fyy", "Fyz", "Fzx", "Fzy", "Fzz")
MEAN_WINDOW = Window(pixel=2.0)
AT_REST = -1


def speed_terms(material: Material, cells: IntArray | None = None) -> OgdenTerms | None:
    """The terms that the small-on-large formula needs; neo-Hooke is Ogden's with m = 2.

    cells : (n,) of the material's block, where its stiffness is a map. None for other laws.
    """
    if material.law == "neo_hooke" and isinstance(material.parameters["mu"], int | float):
        return OgdenTerms(np.array([2 * float(material.parameters["mu"])]), np.array([2.0]))
    if material.law != "ogden":
        return None
    p = material.parameters
    c, m = [], []
    for k in range(1, MAX_TERMS + 1):
        value, exponent = p.get(f"c{k}"), p.get(f"m{k}")
        if value is None:
            continue
        mapped = isinstance(value, ElementMap) and cells is not None
        stiffness = value.values[cells] if mapped else value  # type: ignore[union-attr]
        if not isinstance(stiffness, int | float | np.ndarray) or not isinstance(exponent, int | float):
            return None
        c.append(np.broadcast_to(np.asarray(stiffness, dtype=float), 1 if cells is None else cells.shape))
        m.append(float(exponent))
    return OgdenTerms(np.stack(c, axis=-1), np.array(m))


def element_speeds(model: LimbModel, F: Array, items: IntArray, *, density_kg_per_m3: float) -> Array:
    """Speed (m/s) of the wave along x moving along z in solid cells `items` (numbered over all blocks).

    F : (n, 3, 3). The Ogden family by its closed form, other laws by their tangent.
    """
    speed = np.full(len(items), np.nan)
    first = dict(zip((b.name for b in model.mesh.blocks), _first_cells(model), strict=True))
    for domain in model.domains:
        start, count = first[domain.block], len(model.mesh.block(domain.block).cells)
        here = np.flatnonzero((items >= start) & (items < start + count))
        if not len(here):
            continue
        cells = items[here] - start
        terms = speed_terms(model.materials[domain.material], cells)
        if terms is not None:
            speed[here] = wave_speed_m_per_s(F[here], terms, density_kg_per_m3=density_kg_per_m3)
        else:
            law = model.materials[domain.material]
            Q = acoustic_tensor(law, F[here], np.array([1.0, 0.0, 0.0]), cells=cells, n_cells=count)
            speed[here] = shear_speed_m_per_s(Q, density_kg_per_m3=density_kg_per_m3)
    return speed


def _first_cells(model: LimbModel) -> list[int]:
    return [0, *np.cumsum([len(block.cells) for block in model.mesh.blocks])[:-1].tolist()]


def level_maps(
    model: LimbModel,
    simulation: Simulation,
    rows: Sequence[int] | IntArray,
    *,
    density_kg_per_m3: float,
    window: Window = MEAN_WINDOW,
    pixels: Sequence[tuple[Array, Array] | None] | None = None,
) -> list[SweMap]:
    """The map that the scanner would show at each row of the simulation's times (AT_REST: unloaded).

    pixels : for each level those of its measured map (lateral, depth mm), or None for the window's.
    The model's element record must hold the deformation gradient, its node record the displacements.

    Raises
    ------
    MeasurementError
        If the window holds no tissue at some level.
    """
    elements = _with_fields(simulation.elements.values(), _GRADIENT)
    nodes = _with_fields(simulation.nodes.values(), ("ux", "uy", "uz"))
    corners = np.concatenate([_corners(block.cells) for block in model.mesh.blocks])[elements.items]
    place = np.full(len(model.mesh.points), -1)
    place[nodes.items] = np.arange(len(nodes.items))
    moved = np.stack([nodes.column(name) for name in ("ux", "uy", "uz")], axis=-1)
    gradient = np.stack([elements.column(name) for name in _GRADIENT], axis=-1)
    rest = model.mesh.points[corners].mean(axis=1)
    depths, maps = simulation.probe_depth(), []
    for k, row in enumerate(rows):
        loaded = row != AT_REST
        depth = float(depths[row]) if loaded else 0.0
        positions = rest + moved[row][place[corners]].mean(axis=1) if loaded else rest
        F = gradient[row].reshape(-1, 3, 3) if loaded else np.broadcast_to(np.eye(3), (len(rest), 3, 3))
        own = pixels[k] if pixels is not None else None
        near = _near(positions, depth, window, own)
        speed = element_speeds(model, F[near], elements.items[near], density_kg_per_m3=density_kg_per_m3)
        maps.append(predict_map(positions[near], speed, face_height=-depth, window=window, pixels=own))
    return maps


def mean_speeds(
    model: LimbModel, simulation: Simulation, rows: IntArray, *, density_kg_per_m3: float,
    window: Window = MEAN_WINDOW,
) -> Array:  # fmt: skip
    """Mean over the scanner's window of the predicted speed, m/s (n_levels,); as `level_maps`."""
    maps = level_maps(model, simulation, rows, density_kg_per_m3=density_kg_per_m3, window=window)
    return np.array([float(each.speed_m_per_s.mean()) for each in maps])


def _with_fields(tables: Iterable[Table], fields: tuple[str, ...]) -> Table:
    for each in tables:
        if set(fields) <= set(each.fields):
            return each
    raise MeasurementError(
        f"the simulation recorded no {fields[0]} .. {fields[-1]}",
        where="shear-wave prediction",
        fix="run it again with our templates: they ask for displacements and deformation gradients",
    )


def _corners(cells: IntArray) -> IntArray:
    return cells[:, np.minimum(np.arange(4), cells.shape[1] - 1)]


def _near(
    positions: Array, depth: float, window: Window, pixels: tuple[Array, Array] | None
) -> NDArray[np.bool_]:
    """The elements that some pixel may look at."""
    half, deep = window.half_width, window.depth_to
    if pixels is not None:
        half, deep = float(np.abs(pixels[0]).max()), float(pixels[1].max())
    reach = 2 * window.smoothing + 6.0
    near = np.abs(positions[:, 0]) <= half + reach
    near &= np.abs(positions[:, 1]) <= window.elevation + reach
    return near & (positions[:, 2] >= -depth - deep - reach)
