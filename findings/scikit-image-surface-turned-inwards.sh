#!/bin/sh
# scikit-image 0.26.0 and PyMCubes 0.1.6: the surface of a mask that is 1 in a ball and 0 outside, by
# `marching_cubes`, in the array's own order of axes (x, y, z, as nibabel gives it).
# Guess: normals point outwards by default: gradient_direction "descent" is documented for an object that is
#        greater than what surrounds it.
# Seen:  the triangles are counted the other way round: the enclosed volume is -7099 mm3, PyMCubes' 7099.
#        With "ascent" it is right. A pressure on a skin made so pulls, and a volume mesh is turned inside
#        out.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q scikit-image==0.26.0 PyMCubes==0.1.6 trimesh==5.2.0 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import mcubes
import numpy as np
import trimesh
from skimage.measure import marching_cubes

i, j, k = np.indices((40, 42, 44))
ball = ((i - 20) ** 2 + (j - 21) ** 2 + (k - 22) ** 2 < 12**2).astype(float)
found = {"PyMCubes": mcubes.marching_cubes(ball, 0.5)}
for direction in ("descent", "ascent"):
    found[direction] = marching_cubes(ball, 0.5, gradient_direction=direction)[:2]
found["default"] = marching_cubes(ball, 0.5)[:2]
volumes = {}
for name, (points, faces) in found.items():
    volumes[name] = round(float(trimesh.Trimesh(points, faces.astype(int), process=False).volume))
    print(f"{name}: volume {volumes[name]} mm3, of {ball.sum():.0f} voxels")
true = volumes["PyMCubes"]
turned = {"PyMCubes": true, "descent": -true, "ascent": true, "default": -true}
sys.exit(not (volumes == turned and abs(true / ball.sum() - 1) < 0.02))
PYTHON
