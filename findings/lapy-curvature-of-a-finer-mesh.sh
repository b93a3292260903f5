#!/bin/sh
# lapy 1.7.0: curvature of a sphere of radius 10 mm (`TriaMesh.curvature`), as a mesh of 1280 and of 5120
# triangles, which fit it better and better.
# Guess: 1/10 per mm, of either sign, and nearer to it on the finer mesh: "curvature values at vertices".
# Seen:  0.042 and 0.021 per mm: half with every halving of the edges, as the values are not divided by the
#        area they were summed over. The Gaussian curvature falls to a quarter. A radius of a limb taken from
#        them (24 and 47 mm) is one of the mesh. libigl 2.6.3 has 0.111 and 0.103.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q lapy==1.7.0 libigl==2.6.3 trimesh==5.2.0 numpy==2.4.6 \
  scipy==1.17.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import igl
import lapy
import numpy as np
import trimesh

seen = {}
for level in (3, 4):
    sphere = trimesh.creation.icosphere(subdivisions=level, radius=10.0)
    points, faces = np.array(sphere.vertices), np.array(sphere.faces, np.int64)
    _, _, _, _, mean, gauss, _ = lapy.TriaMesh(points, faces).curvature()
    first, second = igl.principal_curvature(points, faces)[2:4]
    seen[len(faces)] = [round(abs(float(np.median(each))), digits)
                        for each, digits in ((mean, 3), (gauss, 5), (0.5 * (first + second), 3))]
    print(len(faces), "triangles: lapy mean, Gaussian, libigl mean", *seen[len(faces)], "; true 0.1, 0.01, 0.1")
sys.exit(seen != {1280: [0.042, 0.00174, 0.111], 5120: [0.021, 0.00045, 0.103]})
PYTHON
