"""The same model in tet4 or tet10, to see how far a result depends on the element."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import cast

import numpy as np

from limbcli.errors import MeshError
from limbcli.meshing.quality import EDGES
from limbcli.meshing.regions import quadratic
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
    _, _, lookup = quadratic(mesh.points, solid)
    ends = np.array(list(lookup), dtype=np.int64)
    points = np.vstack([mesh.points, mesh.points[ends].mean(axis=1)])

    def middles(cells: IntArray, edges: IntArray) -> IntArray:
        pairs = np.sort(cells[:, edges], axis=2)
        return np.array([[lookup[int(a), int(b)] for a, b in cell] for cell in pairs], np.int64)

    blocks = tuple(
        Block(b.name, "tet10", np.hstack([b.cells, middles(b.cells, np.asarray(EDGES))])) if b.is_solid else b
        for b in mesh.blocks
    )
    rim = np.array([[0, 1], [1, 2], [2, 0]])
    soft = np.unique(solid)
    surfaces = {name: _with_middles(each, middles, rim, soft) for name, each in mesh.surfaces.items()}
    faces = [facets for each in surfaces.values() for kind, facets in each.facets.items() if kind == "tri6"]
    outer = boundary_faces(solid)
    boundary = np.concatenate([*faces, np.hstack([outer, middles(outer, rim)])])
    sets = {name: _completed(nodes, boundary) for name, nodes in mesh.node_sets.items()}
    return _with_records(replace(model, mesh=Mesh(points, blocks, sets, surfaces)))


def _with_middles(surface: Surface, middles: object, rim: IntArray, soft: IntArray) -> Surface:
    facets: dict[str, IntArray] = {}
    for kind, each in surface.facets.items():
        if kind == "tri3" and np.isin(each, soft).all():
            facets["tri6"] = np.hstack([each, middles(each, rim)])  # type: ignore[operator]
        else:
            facets[kind] = each
    return Surface(surface.name, facets)


def _completed(nodes: IntArray, facets: IntArray) -> IntArray:
    """The node set with the mid-side nodes of facets whose corners all belong to it."""
    inside = facets[np.isin(facets[:, :3], nodes).all(axis=1)]
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
