"""A finished simulation as a time series for ParaView: one `.vtu` per step and a `.pvd` that lists them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np

from limbcli.feb.read import read_feb
from limbcli.meshing.export import VTK_TYPES, fibre_rows
from limbcli.model import Array, LimbModel
from limbcli.results import StageWriter
from limbcli.solvers.solver import Simulation, Table

FOLDER = "vtu"
SERIES = "vtu/series.pvd"

_TENSORS = {
    "stress": ("sx", "sy", "sz", "sxy", "syz", "sxz"),
    "deformation_gradient": tuple(f"F{row}{column}" for row in "xyz" for column in "xyz"),
}


def write_series(feb: Path, simulation: Simulation, writer: StageWriter) -> Path:
    """Write the converged steps.

    Points have `displacement` (mm); cells have `part` (index of the block), `J`, `stress`
    (MPa; xx yy zz xy yz xz), `deformation_gradient` (row by row) and all other logged fields, NaN
    where a field was not logged. Rigid bodies are moved by their nodes' displacements if those were
    logged, else by the displacement of their centre.
    """
    model = read_feb(feb)
    writer.file("vtu", SERIES)
    entries = []
    for k, time in enumerate(simulation.times):
        name = f"step_{k:03d}.vtu"
        write_step(model, simulation, k, writer.work / FOLDER / name)
        entries.append(f"<DataSet timestep={quoteattr(f'{time:.12g}')} file={quoteattr(name)}/>")
    text = "\n".join(
        ['<VTKFile type="Collection" version="0.1"><Collection>', *entries, "</Collection></VTKFile>"]
    )
    path = writer.work / SERIES
    path.write_text(text + "\n", encoding="utf-8")
    return path


def write_step(model: LimbModel, simulation: Simulation, k: int, path: Path) -> None:
    mesh = model.mesh
    fields = _cell_fields(model, simulation.elements, k)
    if model.fibres is not None:
        fields["fibre"] = _turned_fibres(model, fields.get("deformation_gradient"))
    bounds = np.cumsum([0, *(len(block.cells) for block in mesh.blocks)])
    spans = list(itertools.pairwise(bounds))
    meshio.Mesh(
        points=mesh.points,
        cells=[(VTK_TYPES[block.kind], block.cells) for block in mesh.blocks],
        point_data={"displacement": displacement(model, simulation, k)},
        cell_data={
            "part": [np.full(len(block.cells), n) for n, block in enumerate(mesh.blocks)],
            **{name: [values[a:b] for a, b in spans] for name, values in fields.items()},
        },
    ).write(path, file_format="vtu")


def _turned_fibres(model: LimbModel, gradient: Array | None) -> Array:
    """Deformed fibre directions (n_cells, 3), F a0 / |F a0|, or those at rest where F was not logged.

    0 in cells without fibres.
    """
    assert model.fibres is not None
    rest = np.concatenate([fibre_rows(block, model.fibres) for block in model.mesh.blocks])
    if gradient is None:
        return rest
    turned = np.einsum("nij,nj->ni", gradient.reshape(-1, 3, 3), rest)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    known = np.isfinite(length) & (length > 0)
    return np.where(known, turned / np.where(known, length, 1.0), rest)


def displacement(model: LimbModel, simulation: Simulation, k: int) -> Array:
    """Displacement (n_points, 3), mm, at step k: logged, else a rigid body's translation, else NaN."""
    found = np.full(model.mesh.points.shape, np.nan)
    for body in model.bodies:
        table = simulation.rigid.get(body.name)
        nodes = [model.mesh.block(name).cells.ravel() for name in body.blocks]
        if table is None or not nodes or not set("xyz") <= set(table.fields):
            continue
        shift = [table.column(axis)[k, 0] for axis in "xyz"]
        found[np.concatenate(nodes)] = np.array(shift) - body.center_of_mass
    for table in simulation.nodes.values():
        if {"ux", "uy", "uz"} <= set(table.fields):
            found[table.items] = np.stack([table.column(name)[k] for name in ("ux", "uy", "uz")], axis=1)
    return found


def _cell_fields(model: LimbModel, tables: Mapping[str, Table], k: int) -> dict[str, Array]:
    n_cells = sum(len(block.cells) for block in model.mesh.blocks)
    columns: dict[str, Array] = {}
    for table in tables.values():
        for name in table.fields:
            values = np.full(n_cells, np.nan)
            values[table.items] = table.column(name)[k]
            columns[name] = values
    fields: dict[str, Array] = {}
    for name, parts in _TENSORS.items():
        if set(parts) <= set(columns):
            fields[name] = np.stack([columns.pop(part) for part in parts], axis=1)
    return {**fields, **columns}
