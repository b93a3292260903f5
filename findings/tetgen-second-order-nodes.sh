#!/bin/sh
# tetgen 0.8.4 (TetGen's Python package): tetrahedra of ten nodes (order=2).
# Guess: the elements that `tetrahedralize` returns have the order of nodes of VTK, Abaqus and FEBio: edges
#        1-2, 2-3, 1-3, 1-4, 2-4, 3-4 after the corners.
# Seen:  they have TetGen's own: 3-4, 1-4, 1-2, 2-3, 2-4, 1-3. `grid` of the same object has VTK's. Written to
#        an Abaqus or FEBio file as they are, five of six mid-side nodes are on other edges.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q tetgen==0.8.4 pyvista==0.49.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys
from itertools import combinations

import numpy as np
import pyvista as pv
import tetgen

EDGES = list(combinations(range(4), 2))


def edges_of(points, cells):
    """The edge, of corners from 1, whose middle each of the nodes 5 to 10 is in all cells."""
    found = []
    for k in range(4, 10):
        for a, b in EDGES:
            if np.allclose(points[cells[:, k]], (points[cells[:, a]] + points[cells[:, b]]) / 2):
                found.append(f"{a + 1}-{b + 1}")
    return found


mesher = tetgen.TetGen(pv.Cube().triangulate())
mesher.tetrahedralize(order=2)
own = edges_of(np.asarray(mesher.node), np.asarray(mesher.elem))
grid = edges_of(mesher.grid.points, mesher.grid.cells_dict[pv.CellType.QUADRATIC_TETRA])
print("elem:", *own)
print("grid:", *grid)
vtk = ["1-2", "2-3", "1-3", "1-4", "2-4", "3-4"]
sys.exit(not (own == ["3-4", "1-4", "1-2", "2-3", "2-4", "1-3"] and grid == vtk))
PYTHON
