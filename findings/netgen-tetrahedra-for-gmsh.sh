#!/bin/sh
# netgen-mesher 6.2.2608, gmsh 4.15.2 and meshio 5.3.5: tetrahedra of a cube of 10 mm by netgen, exported as
# "Gmsh2 Format" and as "Abaqus Format".
# Guess: in each file the corners are counted as the format counts them: volumes are positive, 1000 mm3.
# Seen:  in the Abaqus file they are. In gmsh's they stay as netgen counts them, the base the other way
#        round: -1000 by meshio, and a negative Jacobian in every element by gmsh itself, of four nodes and
#        of ten. No word is said; FEBio (4.11) stops at such elements.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q netgen-mesher==6.2.2608 gmsh==4.15.2 meshio==5.3.5 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import gmsh
import meshio
import numpy as np
from netgen.csg import CSGeometry, OrthoBrick, Pnt

folder = Path(sys.argv[1])
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)


def volume(path):
    mesh = meshio.read(path)
    cells = np.vstack([each.data[:, :4] for each in mesh.cells if each.type.startswith("tetra")])
    a, b, c, d = (mesh.points[cells[:, k]] for k in range(4))
    return round(float(np.einsum("ij,ij->", b - a, np.cross(c - a, d - a)) / 6), 1)


def turned(path):
    """Elements whose Jacobian is negative, of all, by gmsh."""
    gmsh.clear()
    gmsh.open(str(path))
    tags = np.concatenate(gmsh.model.mesh.getElements(3)[1])
    return int(np.sum(np.array(gmsh.model.mesh.getElementQualities(tags, "minDetJac")) < 0)), len(tags)


seen = {}
for order in (1, 2):
    geometry = CSGeometry()
    geometry.Add(OrthoBrick(Pnt(0, 0, 0), Pnt(10, 10, 10)))
    mesh = geometry.GenerateMesh(maxh=6)
    if order == 2:
        mesh.SecondOrder()
    path = folder / f"order{order}.msh"
    mesh.Export(str(path), "Gmsh2 Format")
    seen[order] = volume(path), *turned(path)
    if order == 1:  # meshio does not know the faces of six nodes (CPS6)
        mesh.Export(str(folder / "a.inp"), "Abaqus Format")
        seen["Abaqus"] = volume(folder / "a.inp")
for name, each in seen.items():
    print(f"order {name}: volume, turned, all:" if name in (1, 2) else "Abaqus: volume", each)
good = all(seen[order][0] == -1000 and seen[order][1] == seen[order][2] for order in (1, 2))
sys.exit(not (good and seen["Abaqus"] == 1000))
PYTHON
