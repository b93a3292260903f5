"""The same model in tet4 or tet10, to see how far a result depends on the element."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import cast

import numpy as np

from limbcli.errors import MeshError
from limbcli.meshing.regions import facets, quadratic
from limbcli.meshing.site_mesher import boundary_faces
from limbcli.model import Block, CellKind, IntArray, LimbModel, Mesh, Surface

_CORNERS = {"tet10": 4, "tri6": 3}
_LINEAR = {"tet10": "tet4", "tri6": "tri3"}


def with_element(model: LimbModel, element: str) -> LimbModel:
    """The model with straight-edged tetrahedra of this kind ("tet4" or "tet10").

    tet10 to tet4 drops the mid-side nodes; tet4 to tet10 adds them at the midpoints of the edges. Node sets,
    surfaces and records are updated; element maps are unchanged.

    Raises MeshError if the model has solid cells that are not tetrahedra.
    """
    kinds = {block.kind for block in model.mesh.solid_blocks}
    if not kinds <= {"tet4", "tet10"}:
        raise MeshError(
            f"the model has {', '.join(sorted(kinds - {'tet4', 'tet10'}))} cells",
            where="comparison of elements",
            fix="it works on tetrahedra only; mesh with --element tet4 or tet10",
        )
    if kinds == {element}:
        return model
    return _linear(model) if element == "tet4" else _quadratic(model)


def _linear(model: LimbModel) -> LimbModel:
    mesh = model.mesh
    blocks = [
        replace(each, kind=_kind(each.kind), cells=_corners(each.kind, each.cells)) for each in mesh.blocks
    ]
    used = np.unique(np.concatenate([block.cells.ravel() for block in blocks]))
    new = np.full(len(mesh.points), -1, dtype=np.int64)
    new[used] = np.arange(len(used))
    sets = {name: new[nodes][new[nodes] >= 0] for name, nodes in mesh.node_sets.items()}
    surfaces = {
        name: Surface(each.name, {
            _kind(kind): new[_corners(kind, facets)]
            for kind, facets in each.facets.items()
        })
        for name, each in mesh.surfaces.items()
    }  # fmt: skip
    moved = tuple(replace(block, cells=new[block.cells]) for block in blocks)
    return _with_records(replace(model, mesh=Mesh(mesh.points[used], moved, sets, surfaces)))


def _kind(kind: str) -> CellKind:
    return cast(CellKind, _LINEAR.get(kind, kind))


def _corners(kind: str, cells: IntArray) -> IntArray:
    return cells[:, : _CORNERS.get(kind, cells.shape[1])]


def _quadratic(model: LimbModel) -> LimbModel:
    mesh = model.mesh
    solid = np.concatenate([block.cells for block in mesh.solid_blocks])
    points, cells, lookup = quadratic(mesh.points, solid)
    parts = iter(np.split(cells, np.cumsum([len(block.cells) for block in mesh.solid_blocks])[:-1]))
    blocks = tuple(Block(b.name, "tet10", next(parts)) if b.is_solid else b for b in mesh.blocks)
    soft = np.unique(solid)
    surfaces = {name: _with_middles(each, lookup, soft) for name, each in mesh.surfaces.items()}
    faces = [own for each in surfaces.values() for kind, own in each.facets.items() if kind == "tri6"]
    boundary = np.concatenate([*faces, facets(boundary_faces(solid), lookup)["tri6"]])
    sets = {name: _completed(nodes, boundary) for name, nodes in mesh.node_sets.items()}
    return _with_records(replace(model, mesh=Mesh(points, blocks, sets, surfaces)))


def _with_middles(surface: Surface, lookup: dict[tuple[int, int], int], soft: IntArray) -> Surface:
    found: dict[str, IntArray] = {}
    for kind, each in surface.facets.items():
        in_tissue = kind == "tri3" and np.isin(each, soft).all()
        found |= facets(each, lookup) if in_tissue else {kind: each}
    return Surface(surface.name, found)


def _completed(nodes: IntArray, boundary: IntArray) -> IntArray:
    """The node set with the mid-side nodes of facets whose corners all belong to it."""
    inside = boundary[np.isin(boundary[:, :3], nodes).all(axis=1)]
    return np.unique(np.concatenate([nodes, inside[:, 3:].ravel()]))


def _with_records(model: LimbModel) -> LimbModel:
    """Make node records list all tissue nodes again; cell records are unchanged."""
    nodes = model.mesh.solid_nodes
    records = tuple(
        replace(each, items=nodes) if each.kind == "node" and each.items is not None else each
        for each in model.records
    )
    info: Mapping[str, object] = {**model.info, "element": model.mesh.solid_blocks[0].kind}
    return replace(model, records=records, info=info)
