#!/bin/sh
# gmsh 4.15.2 and meshio 5.3.5: a cube of 10 mm in eight bricks of twenty nodes, saved by gmsh as VTK and as
# MSH, and opened by gmsh again.
# Guess: the bricks come back as they were: gmsh turns the order of nodes between its own and VTK's in
#        writing, and meshio reads the file rightly.
# Seen:  gmsh reads VTK's order as its own: nine of twelve mid-side nodes are on other edges, the Jacobian
#        is negative in every brick, and no word is said. From MSH they come back, and tetrahedra of ten
#        nodes from VTK too.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q gmsh==4.15.2 meshio==5.3.5 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import gmsh
import meshio
import numpy as np

OF_VTK = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
OF_GMSH = [(0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7)]
folder = Path(sys.argv[1])
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 1)


def off(cells, edges):
    """Mid-side nodes that are not in the middle of their edge; cells (n_cells, 20, 3)."""
    return sum(not np.allclose(cells[:, 8 + k], cells[:, edge].mean(axis=1)) for k, edge in enumerate(edges))


def by_gmsh(path):
    gmsh.clear()
    gmsh.open(str(path))
    tags, points, _ = gmsh.model.mesh.getNodes()
    place = dict(zip(tags, points.reshape(-1, 3)))
    elements, nodes = gmsh.model.mesh.getElementsByType(17)  # bricks of twenty nodes
    jacobian = np.array(gmsh.model.mesh.getElementQualities(elements, "minDetJac"))
    cells = np.array([place[node] for node in nodes]).reshape(-1, 20, 3)
    return off(cells, [list(edge) for edge in OF_GMSH]), int(np.sum(jacobian < 0)), len(elements)


square = gmsh.model.occ.addRectangle(0, 0, 0, 10, 10)
gmsh.model.occ.synchronize()
for _, curve in gmsh.model.getEntities(1):
    gmsh.model.mesh.setTransfiniteCurve(curve, 3)
gmsh.model.mesh.setTransfiniteSurface(square)
gmsh.model.mesh.setRecombine(2, square)
gmsh.model.occ.extrude([(2, square)], 0, 0, 10, numElements=[2], recombine=True)
gmsh.model.occ.synchronize()
gmsh.model.addPhysicalGroup(3, [1], name="muscle")
gmsh.model.mesh.generate(3)
gmsh.model.mesh.setOrder(2)
for ending in ("vtk", "msh"):
    gmsh.write(str(folder / f"a.{ending}"))

mesh = meshio.read(folder / "a.vtk")
seen = {"meshio vtk": off(mesh.points[mesh.cells_dict["hexahedron20"]], [list(edge) for edge in OF_VTK])}
seen |= {f"gmsh {ending}": by_gmsh(folder / f"a.{ending}") for ending in ("msh", "vtk")}
for name, each in seen.items():
    print(name, "mid-side nodes off (gmsh: and bricks turned, of all):", each)
sys.exit(seen != {"meshio vtk": 0, "gmsh msh": (0, 0, 8), "gmsh vtk": (9, 8, 8)})
PYTHON
