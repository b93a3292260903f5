#!/bin/sh
# evalseg 2.7: distances (`HD`) of masks with voxels of 2 mm: a ball of radius 15 voxels to itself and to the
# same ball with a rod that stands out by 15 voxels.
# Guess: 0 of the mask to itself; to that with the rod a maximum of 30 mm, as of medpy 0.5.2, whichever of the
#        two is the reference.
# Seen:  2 mm to itself, in "avg", "95th" and "max": voxels of an outline are a voxel away from what is outside,
#        and that is their distance. With the rod "max" is 18 mm: of the two directions (30 and 6) the mean
#        is taken, not the larger.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q evalseg==2.7 memory_profiler==0.61.0 edt==3.0.0 medpy==0.5.2 numpy==2.2.6 scipy==1.17.1 \
  2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from evalseg.io import SegmentArray
from evalseg.metrics.hd import HD
from medpy.metric import binary

VOXEL = [2, 2, 2]
k, j, i = np.indices((60, 60, 60))
ball = (k - 30) ** 2 + (j - 30) ** 2 + (i - 25) ** 2 < 15**2
with_rod = ball | ((abs(k - 30) < 3) & (abs(j - 30) < 3) & (i > 25) & (i < 55))
metric = HD()
metric.set_reference(SegmentArray(ball, voxelsize=VOXEL))
seen = {}
for name, other in (("itself", ball), ("with a rod", with_rod)):
    found = metric.evaluate(SegmentArray(other, voxelsize=VOXEL))
    seen[name] = [round(float(found[each]), 1) for each in ("avg", "95th", "max")]
    seen[name].append(float(binary.hd(ball, other, VOXEL)))
    print(f"{name}: average, 95 %, maximum by evalseg", *seen[name][:3], "mm; maximum by medpy", seen[name][3], "mm")
sys.exit(seen != {"itself": [2.0, 2.0, 2.0, 0.0], "with a rod": [2.8, 9.0, 18.2, 30.0]})
PYTHON
