#!/bin/sh
# gmsh 4.15.2 and meshio 5.3.5: two cubes of 10 mm, the groups "muscle" and "fat", and both in a third,
# "tissue", saved in the two versions of the format MSH that programs read, 2.2 and 4.1.
# Guess: the same tetrahedra in both: 2000 mm3.
# Seen:  in 2.2 every tetrahedron is there twice, once for each of its groups: 4000 mm3. A solver that takes
#        all elements gets tissue that is twice as stiff and heavy, and neither program says a word.
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

path = Path(sys.argv[1]) / "a.msh"
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
boxes = [(3, gmsh.model.occ.addBox(x, 0, 0, 10, 10, 10)) for x in (0, 10)]
gmsh.model.occ.fragment(boxes[:1], boxes[1:])
gmsh.model.occ.synchronize()
for name, volumes in (("muscle", [1]), ("fat", [2]), ("tissue", [1, 2])):
    gmsh.model.addPhysicalGroup(3, volumes, name=name)
gmsh.option.setNumber("Mesh.MeshSizeMax", 5)
gmsh.model.mesh.generate(3)
n = len(gmsh.model.mesh.getElementsByType(4)[0])
seen = {}
for version in (2.2, 4.1):
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.write(str(path))
    mesh = meshio.read(path)
    corners = mesh.points[mesh.cells_dict["tetra"]]
    volume = abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6
    seen[version] = len(corners) / n, round(float(volume))
    print(f"MSH {version}: {len(corners)} tetrahedra of {n}, {volume:.0f} mm3")
gmsh.finalize()
sys.exit(seen != {2.2: (2.0, 4000), 4.1: (1.0, 2000)})
PYTHON
