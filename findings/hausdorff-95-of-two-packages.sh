#!/bin/sh
# medpy 0.5.2 and surface-distance 0.1: the 95 % Hausdorff distance of two masks with voxels of 1 mm: a ball
# of radius 15, and the same ball with a rod that stands out by 15 mm.
# Guess: one number, since both packages give the distance under this name.
# Seen:  medpy takes the percentile of the distances of both directions together, surface-distance the larger
#        of the two directions' percentiles: 2 and 7 mm. The largest distance, 15 mm, is the same in both.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q medpy==0.5.2 surface-distance==0.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import surface_distance
from medpy.metric import binary

k, j, i = np.indices((60, 60, 60))
ball = (k - 30) ** 2 + (j - 30) ** 2 + (i - 25) ** 2 < 15**2
with_rod = ball | ((abs(k - 30) < 3) & (abs(j - 30) < 3) & (i > 25) & (i < 55))
voxel = (1.0, 1.0, 1.0)
distances = surface_distance.compute_surface_distances(ball, with_rod, voxel)
seen = {}
for percent, by_medpy in ((95, binary.hd95), (100, binary.hd)):
    both = by_medpy(ball, with_rod, voxel), surface_distance.compute_robust_hausdorff(distances, percent)
    seen[percent] = tuple(float(each) for each in both)
    print(f"{percent} %: medpy {both[0]:.1f} mm, surface-distance {both[1]:.1f} mm")
sys.exit(seen != {95: (2.0, 7.0), 100: (15.0, 15.0)})
PYTHON
