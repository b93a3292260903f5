#!/bin/sh
# trimesh 5.2.0 and VTK 9.7.2 (with pyvista 0.49.1): a surface like a limb's laid on the same surface 5 %
# smaller (the limb after its swelling) by each package's iterative closest points.
# Guess: a motion, as of pyvista's `align`: iterative closest points (Besl and McKay 1992) turns and moves.
# Seen:  trimesh (`registration.icp`, whose signature does not name it) and vtkIterativeClosestPointTransform
#        also scale: by 0.95 each. The two surfaces lie on each other, and the loss of volume (14 %) that was
#        to be measured is gone.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q trimesh==5.2.0 pyvista==0.49.1 vtk==9.7.2 scipy==1.17.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import pyvista as pv
import trimesh
from trimesh.registration import icp
from vtkmodules.vtkCommonDataModel import vtkIterativeClosestPointTransform

limb = trimesh.creation.capsule(height=100, radius=50, count=[40, 40])
limb.vertices = limb.vertices * [1, 0.8, 1]
limb.vertices[:, 0] *= 1 + 0.002 * limb.vertices[:, 2]
later = limb.copy()
later.apply_scale(0.95)
later.apply_transform(trimesh.transformations.rotation_matrix(0.05, [0, 0, 1]))
by_trimesh, _, _ = icp(limb.vertices, later.vertices, max_iterations=100)
by_vtk = vtkIterativeClosestPointTransform()
by_vtk.SetSource(pv.wrap(limb))
by_vtk.SetTarget(pv.wrap(later))
by_vtk.SetMaximumNumberOfIterations(100)
by_vtk.Update()
_, by_pyvista = pv.wrap(limb).align(pv.wrap(later), return_matrix=True)
found = {"trimesh": by_trimesh, "VTK": pv.array_from_vtkmatrix(by_vtk.GetMatrix()), "pyvista": by_pyvista}
scale = {name: float(np.cbrt(np.linalg.det(matrix[:3, :3]))) for name, matrix in found.items()}
for name, each in scale.items():
    print(f"{name}: the limb is scaled by {each:.3f}")
seen = {name: round(each, 3) for name, each in scale.items()}
sys.exit(seen != {"trimesh": 0.95, "VTK": 0.95, "pyvista": 1})
PYTHON
