#!/bin/sh
# scikit-spatial 10.0.0: `Cylinder.best_fit` of points of a limb-like cylinder, radius 40 mm, from z = 0 to 100
# mm: all round, and without the back above 30 mm, as where a scanner did not reach.
# Guess: both span the points: 100 mm long, from 0 to 100.
# Seen:  the second is 117 mm long and reaches from -17 to 100 mm, a volume 17 % too large. The points' mean is
#        taken as the middle of the axis, and the farthest point from it as both ends. The radius is right. No
#        word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q scikit-spatial==10.0.0 numpy==2.4.6 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from skspatial.objects import Cylinder

grid = np.meshgrid(np.radians(np.arange(0, 360, 10)), np.arange(0, 101, 5.0))
angle, height = (each.ravel() for each in grid)
points = np.column_stack([40 * np.cos(angle), 40 * np.sin(angle), height])
seen = {}
for name, kept in (("all round", height >= 0), ("without the upper back", (np.cos(angle) > 0) | (height < 30))):
    cylinder = Cylinder.best_fit(points[kept])
    ends = sorted(float(z) for z in (cylinder.point[2], cylinder.point[2] + cylinder.vector[2]))
    seen[name] = [round(each) for each in (*ends, cylinder.length(), cylinder.radius)]
    print(f"{name}: from {ends[0]:.1f} to {ends[1]:.1f} mm, radius {cylinder.radius:.1f}")
sys.exit(seen != {"all round": [0, 100, 100, 40], "without the upper back": [-17, 100, 117, 40]})
PYTHON
