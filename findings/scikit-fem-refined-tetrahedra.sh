#!/bin/sh
# scikit-fem 12.0.2, meshio 5.3.5 and gmsh 4.15.2: a cube of 10 mm in tetrahedra by gmsh, all counted so that
# their volume is positive; read by scikit-fem, refined once, and saved as Abaqus input.
# Guess: the eight parts of a tetrahedron are counted as it was.
# Seen:  more than half are counted the other way round: their volume is negative, in `t` and in the file,
#        though scikit-fem itself computes with both. FEBio (4.11) stops at such elements (negative Jacobian);
#        a sum of volumes loses twice what they hold.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q scikit-fem==12.0.2 meshio==5.3.5 gmsh==4.15.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import gmsh
import meshio
import numpy as np
from skfem import MeshTet

folder = Path(sys.argv[1])
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.occ.addBox(0, 0, 0, 10, 10, 10)
gmsh.model.occ.synchronize()
gmsh.model.addPhysicalGroup(3, [1], name="tissue")
gmsh.option.setNumber("Mesh.MeshSizeMax", 6)
gmsh.model.mesh.generate(3)
gmsh.write(str(folder / "a.msh"))
gmsh.finalize()
tissue = meshio.read(folder / "a.msh")
mesh = MeshTet(tissue.points.T, tissue.cells_dict["tetra"].T)
turned = {}
for name, each in (("as read", mesh), ("refined", mesh.refined(1))):
    each.save(str(folder / "b.inp"))
    saved = meshio.read(folder / "b.inp")
    corners = saved.points[saved.cells_dict["tetra"]]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    turned[name] = float((volumes < 0).mean())
    print(f"{name}: {turned[name]:.0%} of {len(volumes)} turned; volume {abs(volumes).sum():.0f} mm3,"
          f" with signs {volumes.sum():.0f}")  # fmt: skip
sys.exit(not (turned["as read"] == 0 and turned["refined"] > 0.5))
PYTHON
