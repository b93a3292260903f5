#!/bin/sh
# gmsh 4.15.2 and meshio 5.3.5: tetrahedra of a cube of 10 mm in the MED format (Salome, Code_Aster).
# Guess: meshio returns what gmsh wrote, in its own order of nodes, in which a tetrahedron's volume is
#        positive.
# Seen:  gmsh writes MED's order, in which the base is counted the other way round; meshio does not turn it
#        back. All volumes are negative, -1000 in place of 1000. The same mesh in gmsh's own format is read
#        rightly.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q gmsh==4.15.2 meshio==5.3.5 h5py==3.16.0 2>/dev/null
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import gmsh
import meshio
import numpy as np

folder = Path(sys.argv[1])
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.occ.addBox(0, 0, 0, 10, 10, 10)
gmsh.model.occ.synchronize()
gmsh.model.addPhysicalGroup(3, [1], name="tissue")  # meshio reads no MED without groups
gmsh.option.setNumber("Mesh.MeshSizeMax", 6)
gmsh.model.mesh.generate(3)
volumes = {}
for ending in ("msh", "med"):
    gmsh.write(str(folder / f"a.{ending}"))
    mesh = meshio.read(folder / f"a.{ending}")
    corners = mesh.points[mesh.cells_dict["tetra"]]
    volumes[ending] = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    print(f"{ending}: {len(corners)} tetrahedra, volume {volumes[ending].sum():.1f} mm3")
gmsh.finalize()
same = len(volumes["msh"]) == len(volumes["med"]) and np.isclose(volumes["msh"].sum(), 1000)
sys.exit(not (same and (volumes["msh"] > 0).all() and (volumes["med"] < 0).all()))
PYTHON
