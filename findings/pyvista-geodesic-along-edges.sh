#!/bin/sh
# pyvista 0.49.1 (VTK 9.7.2) and pygeodesic 0.1.11: the way over a surface from corner to corner of a plane
# of 100 x 100 mm in right-angled triangles, as a surface of rings and lines has them (a limb unrolled).
# Guess: some per cent too long at most, and better with smaller triangles: both have 141.4 mm.
# Seen:  pyvista's `geodesic_distance` goes along edges: 200 mm (+41 %) across the triangles' diagonals,
#        141.4 mm along them, with triangles of any size. A tape around a limb, oblique, is as much too long.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyvista==0.49.1 vtk==9.7.2 pygeodesic==0.1.11 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import pyvista as pv
from pygeodesic.geodesic import PyGeodesicAlgorithmExact

seen = {}
for n in (10, 20, 40):
    plane = pv.Plane(i_size=100, j_size=100, i_resolution=n, j_resolution=n).triangulate()
    points = np.array(plane.points, float)
    exact = PyGeodesicAlgorithmExact(points, plane.regular_faces)
    for ends in (((-50, -50), (50, 50)), ((-50, 50), (50, -50))):
        first, last = (int(np.argmin(np.hypot(*(points[:, :2] - end).T))) for end in ends)
        lengths = plane.geodesic_distance(first, last), exact.geodesicDistance(first, last)[0]
        seen[n, ends] = sorted(round(float(each), 1) for each in lengths)
        print(f"{n} x {n}, {ends}: pyvista {lengths[0]:.1f} mm, pygeodesic {lengths[1]:.1f} mm")
along, across = ([each for (_, ends), each in seen.items() if ends[0][1] == y] for y in (-50, 50))
straight, stairs = [[141.4, 141.4]] * 3, [[141.4, 200.0]] * 3
sys.exit((along, across) not in ((straight, stairs), (stairs, straight)))
PYTHON
