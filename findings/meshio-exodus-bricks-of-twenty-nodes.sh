#!/bin/sh
# meshio 5.3.5 and VTK 9.7.2: an Exodus II file of one brick of twenty nodes (HEX20, a cube of 10 mm) in the
# order of the format's manual, in which the nodes of the upright edges come before those of the top.
# Guess: both return VTK's order, which meshio documents for its cells: each mid-side node between the
#        corners of its edge.
# Seen:  VTK turns the order; meshio passes the numbers on: eight of twelve mid-side nodes are on other
#        edges. What meshio writes as Exodus is in VTK's order, and VTK (ParaView) reads it with the same
#        eight off. Tetrahedra of ten nodes have one order in both, and are right.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q meshio==5.3.5 netCDF4==1.7.4 vtk==9.7.2 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import meshio
import netCDF4
import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOExodus import vtkExodusIIReader

CORNERS = np.array([(x, y, z) for z in (0, 10.0) for x, y in ((0, 0), (10, 0), (10, 10), (0, 10))])
BOTTOM, TOP = ((0, 1), (1, 2), (2, 3), (3, 0)), ((4, 5), (5, 6), (6, 7), (7, 4))
UPRIGHT = ((0, 4), (1, 5), (2, 6), (3, 7))
VTK, EXODUS = BOTTOM + TOP + UPRIGHT, BOTTOM + UPRIGHT + TOP


def nodes(edges):
    return np.vstack([CORNERS] + [CORNERS[list(edge)].mean(axis=0) for edge in edges])


def off(points):
    """Mid-side nodes that are not on the edge that VTK's order gives them."""
    return int(sum(np.any(points[8:] != nodes(VTK)[8:], axis=1)))


def write(path):
    """The parts of the format that hold nodes and one block of elements (Exodus II manual, NetCDF-3)."""
    points = nodes(EXODUS)
    with netCDF4.Dataset(path, "w", format="NETCDF3_64BIT_OFFSET") as file:
        file.api_version = file.version = np.float32(5.1)
        file.floating_point_word_size, file.file_size, file.title = np.int32(8), np.int32(1), "brick"
        sizes = {"num_dim": 3, "num_nodes": 20, "num_elem": 1, "num_el_blk": 1, "num_el_in_blk1": 1,
                 "num_nod_per_el1": 20, "len_name": 33, "len_string": 33, "len_line": 81, "time_step": None}
        for name, size in sizes.items():
            file.createDimension(name, size)
        for k, axis in enumerate("xyz"):
            file.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = points[:, k]
        file.createVariable("eb_status", "i4", ("num_el_blk",))[:] = 1
        numbers = file.createVariable("eb_prop1", "i4", ("num_el_blk",))
        numbers[:] = 1
        numbers.setncattr("name", "ID")
        block = file.createVariable("connect1", "i4", ("num_el_in_blk1", "num_nod_per_el1"))
        block.elem_type = "HEX20"
        block[:] = np.arange(1, 21)[None]
        file.createVariable("time_whole", "f8", ("time_step",))


def by_vtk(path):
    reader = vtkExodusIIReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput().GetBlock(0).GetBlock(0)
    ids = [grid.GetCell(0).GetPointId(k) for k in range(20)]
    return vtk_to_numpy(grid.GetPoints().GetData())[ids]


def by_meshio(path):
    mesh = meshio.read(path)
    return mesh.points[mesh.cells_dict["hexahedron20"][0]]


folder = Path(sys.argv[1])
write(folder / "manual.e")
meshio.write(folder / "meshio.e", meshio.Mesh(nodes(VTK), {"hexahedron20": np.arange(20)[None]}))
seen = {f"{name} by {reader.__name__[3:]}": off(reader(folder / name))
        for name in ("manual.e", "meshio.e") for reader in (by_vtk, by_meshio)}
for name, each in seen.items():
    print(name, each, "of 12 mid-side nodes off")
sys.exit(list(seen.values()) != [0, 8, 8, 0])
PYTHON
