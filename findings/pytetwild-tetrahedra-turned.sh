#!/bin/sh
# pytetwild 0.4.2 and pyvista 0.49.1: tetrahedra of a sphere of radius 10 mm, by `tetrahedralize`, which
# returns arrays, and by `tetrahedralize_pv`, which returns a grid.
# Guess: both count the corners alike, so that volumes are positive, as of tetgen's `tetrahedralize`.
# Seen:  those of the grid do; in the arrays all are counted the other way round. Written to an Abaqus or
#        FEBio file (4.11) as they are, the solver stops at the first; pressure on faces taken from them
#        pulls.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pytetwild==0.4.2 tetgen==0.8.4 pyvista==0.49.1 2>/dev/null
cd "$folder"  # fTetWild leaves a file where it runs
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import pytetwild
import pyvista as pv
import tetgen


def turned(points, cells):
    """Tetrahedra of negative volume, of all."""
    a, b, c, d = (np.asarray(points, float)[cells[:, k]] for k in range(4))
    return int(np.sum(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) < 0)), len(cells)


sphere = pv.Sphere(radius=10, theta_resolution=16, phi_resolution=16)
points, cells = np.asarray(sphere.points, float), sphere.faces.reshape(-1, 4)[:, 1:]
grid = pytetwild.tetrahedralize_pv(sphere)
mesher = tetgen.TetGen(sphere)
mesher.tetrahedralize()
seen = {"arrays": turned(*pytetwild.tetrahedralize(points, cells)[:2]),
        "grid": turned(grid.points, grid.cells_dict[pv.CellType.TETRA]),
        "tetgen's arrays": turned(mesher.node, mesher.elem)}
for name, (bad, n) in seen.items():
    print(name, "turned:", bad, "of", n)
share = [bad / n for bad, n in seen.values()]
sys.exit(share != [1, 0, 0])
PYTHON
