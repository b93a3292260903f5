#!/bin/sh
# pyvista 0.49.1 (VTK 9.7.2): the open ends of a tube (radius 5, length 20 mm) closed by `fill_holes`, as of a
# scanned limb.
# Guess: the result is a closed surface whose volume is that of the cylinder, 1561 mm3.
# Seen:  it is closed and manifold, but the new triangles are wound the other way than their neighbours:
#        `volume` is 50 mm3. `compute_normals(auto_orient_normals=True)` turns them, and gives 1561.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyvista==0.49.1 vtk==9.7.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import pyvista as pv

SIDES, RADIUS, LENGTH = 32, 5.0, 20.0
angle = 2 * np.pi * np.arange(SIDES) / SIDES
ring = RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])
points = np.vstack([np.column_stack([ring, np.full(SIDES, z)]) for z in (-LENGTH / 2, LENGTH / 2)])
k = np.arange(SIDES)
following = (k + 1) % SIDES
faces = np.vstack([np.column_stack([k, following, SIDES + following]),
                   np.column_stack([k, SIDES + following, SIDES + k])])  # fmt: skip
tube = pv.PolyData.from_regular_faces(points, faces)
true = 0.5 * SIDES * np.sin(2 * np.pi / SIDES) * RADIUS**2 * LENGTH
closed = tube.fill_holes(100)
turned = closed.compute_normals(auto_orient_normals=True)
print(f"open edges {closed.n_open_edges}, manifold {closed.is_manifold}")
print(f"volume {closed.volume:.0f} mm3, turned {turned.volume:.0f}, of the prism {true:.0f}")
good = closed.n_open_edges == 0 and closed.is_manifold and np.isclose(turned.volume, true)
sys.exit(not (good and closed.volume < 0.1 * true))
PYTHON
