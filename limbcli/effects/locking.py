"""Volumetric locking: constant-strain tetrahedra cannot deform at constant volume without stiffening.

At K/mu = 200 to 1300 (f_kappa 100 to 650) linear tetrahedra give forces two to six times too high, increasing
with f_kappa. This is not tested statistically: the elements are exchanged (tet4 to tet10 on the same corners)
and the prediction is compared again.
Tell-tale: the force scale grows with f_kappa; the superficial third of the speeds is 20 % low.
Source: Hughes 2000, The Finite Element Method, section 4.4; Puso & Solberg 2006, Int J Numer Meth Eng 67:841
(constant-strain tetrahedra near incompressibility).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.meshing.regions import quadratic
from limbcli.model import Block, IntArray, LimbModel, LogRecord, Mesh, Surface

MENDED = Parameter("quadratic_elements", null=0.0, start=1.0, low=0.0, high=1.0, typical=1.0, prior="0 or 1")


def apply(model: LimbModel, theta: Theta) -> LimbModel:
    """Convert each tet4 block to tet10 with straight edges, together with its facets and node sets."""
    linear = [block for block in model.mesh.blocks if block.kind == "tet4"]
    if theta[MENDED.name] < 0.5 or not linear:
        return model
    mesh = model.mesh
    stacked = np.concatenate([block.cells for block in linear])
    points, cells, middle = quadratic(mesh.points, stacked)
    parts = iter(np.split(cells, np.cumsum([len(block.cells) for block in linear])[:-1]))
    blocks = tuple(
        Block(each.name, "tet10", next(parts)) if each.kind == "tet4" else each for each in mesh.blocks
    )
    surfaces = {name: _surface(each, middle) for name, each in mesh.surfaces.items()}
    faces = {name: each.facets["tri6"] for name, each in surfaces.items() if "tri6" in each.facets}
    sets = {name: _nodes(nodes, middle, faces.get(name)) for name, nodes in mesh.node_sets.items()}
    records = tuple(_record(each, len(points) - len(mesh.points), mesh) for each in model.records)
    return replace(model, mesh=Mesh(points, blocks, sets, surfaces), records=records)


def _surface(surface: Surface, middle: dict[tuple[int, int], int]) -> Surface:
    found: dict[str, IntArray] = {}
    for kind, facets in surface.facets.items():
        ends = np.sort(facets[:, [[0, 1], [1, 2], [2, 0]]], axis=2) if kind == "tri3" else None
        if ends is None or not all((int(a), int(b)) in middle for a, b in ends.reshape(-1, 2)):
            found[kind] = facets
            continue
        mids = np.array([[middle[int(a), int(b)] for a, b in each] for each in ends], np.int64)
        found["tri6"] = np.hstack([facets, mids.reshape(-1, 3)])
    return Surface(surface.name, found)


def _nodes(nodes: IntArray, middle: dict[tuple[int, int], int], facets: IntArray | None) -> IntArray:
    """A node set with the mid-nodes of its edges: those of its facets if it has a surface, else those of all
    edges between its nodes."""
    if facets is not None:
        return np.unique(np.concatenate([nodes, facets.ravel()]))
    inside = set(nodes.tolist())
    added = [number for (a, b), number in middle.items() if a in inside and b in inside]
    return np.unique(np.concatenate([nodes, np.array(added, dtype=np.int64)]))


def _record(record: LogRecord, n_added: int, mesh: Mesh) -> LogRecord:
    """A record with the mid-nodes added if it is of the tissue's nodes; cells keep their numbers."""
    if record.kind != "node" or record.items is None or isinstance(record.items, str):
        return record
    first = len(mesh.points)
    return replace(record, items=np.concatenate([record.items, np.arange(first, first + n_added)]))


EFFECT = Effect(
    name="locking",
    sentence="the linear elements lock: the mesh, not the tissue, determines the force",
    kind="numerical",
    source="Hughes 2000, The Finite Element Method, section 4.4",
    parameters=(MENDED,),
    apply=apply,
    solves=True,
    new_mesh=True,
)
