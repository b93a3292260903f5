"""Export of the mesh with its sets: one VTU file that opens in ParaView."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.meshing.quality import dihedral_angles_deg
from limbcli.model import Array, Block, ElementMap, Mesh

VTK_TYPES = {
    "tet4": "tetra", "tet10": "tetra10", "hex8": "hexahedron", "penta6": "wedge",
    "tri3": "triangle", "tri6": "triangle6", "quad4": "quad",
}  # fmt: skip


def write_vtu(
    mesh: Mesh,
    path: Path,
    *,
    fibres: ElementMap | None = None,
    values: Mapping[str, Mapping[str, Array]] | None = None,
    at_points: Mapping[str, Array] | None = None,
) -> None:
    """Write all blocks as cells, and every node set and surface as a point array of 0 and 1.

    Cell arrays: `block` (its number), one array of 0 and 1 per block name, `min_dihedral_deg`, and, if given,
    `fibre` (3 components in the site's frame; 0 outside the tissue) and `values`.

    values : by block, then by name, a value for each of its cells (n_cells,); NaN in other blocks
    at_points : by name, a value (n_points,) or vector (n_points, 3) for each point
    """
    import meshio

    cells = [(VTK_TYPES[each.kind], each.cells) for each in mesh.blocks]
    point_data = {f"set_{name}": _marked(len(mesh.points), nodes) for name, nodes in mesh.node_sets.items()}
    for name, surface in mesh.surfaces.items():
        nodes = np.concatenate([each.ravel() for each in surface.facets.values()])
        point_data[f"surface_{name}"] = _marked(len(mesh.points), nodes)
    point_data |= dict(at_points or {})
    cell_data: dict[str, list[Any]] = {
        "block": [np.full(len(each.cells), k, np.int32) for k, each in enumerate(mesh.blocks)],
        "min_dihedral_deg": [_smallest_angle(mesh, each) for each in mesh.blocks],
    }
    for chosen in mesh.blocks:
        cell_data[f"block_{chosen.name}"] = [
            np.full(len(each.cells), each is chosen, np.uint8) for each in mesh.blocks
        ]
    if fibres is not None:
        cell_data["fibre"] = [fibre_rows(each, fibres) for each in mesh.blocks]
    for name in dict.fromkeys(name for each in (values or {}).values() for name in each):
        cell_data[name] = [
            (values or {}).get(each.name, {}).get(name, np.full(len(each.cells), np.nan))
            for each in mesh.blocks
        ]
    meshio.Mesh(mesh.points, cells, point_data=point_data, cell_data=cell_data).write(path, file_format="vtu")


def fibre_rows(block: Block, fibres: ElementMap) -> Array:
    """Fibre directions (n_cells, 3) of a block; 0 where there are none."""
    return fibres.values if block.name == fibres.block else np.zeros((len(block.cells), 3))


def _marked(n: int, chosen: Any) -> Any:
    out = np.zeros(n, np.uint8)
    out[np.asarray(chosen, int)] = 1
    return out


def _smallest_angle(mesh: Mesh, block: Block) -> Any:
    """Smallest dihedral angle of each cell; NaN for cells that are not tetrahedra."""
    if block.kind not in ("tet4", "tet10"):
        return np.full(len(block.cells), np.nan)
    return dihedral_angles_deg(mesh.points, block.cells).min(axis=1)
