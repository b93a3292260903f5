#!/bin/sh
# localthickness 0.1.3: `local_thickness` of a layer 12 voxels thick, as of skin in a label map, and of a rod
# 21 voxels thick.
# Guess: 12 and 21: the local thickness is the diameter of the largest ball that fits in and holds the voxel
#        (Hildebrand and Ruegsegger 1997).
# Seen:  6 in the layer and 10.6 in the rod: the ball's radius, under the name of the thickness. No word is
#        said, and a skin of 2 mm becomes one of 1 mm.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q localthickness==0.1.3 matplotlib==3.11.2 scikit-image==0.26.0 \
  edt==3.1.2 numpy==2.2.0 scipy==1.17.1 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import localthickness
import numpy as np

layer = np.zeros((60, 60, 40), bool)
layer[:, :, 14:26] = True
x, y = np.mgrid[-20:21, -20:21]
rod = np.repeat((x**2 + y**2 < 10.5**2)[:, :, None], 60, axis=2)
seen = {}
for name, mask, thick in (("layer", layer, 12), ("rod", rod, 21)):
    middle = tuple(n // 2 for n in mask.shape)
    seen[name] = round(float(localthickness.local_thickness(mask)[middle]), 1)
    print(f"{name}: {thick} voxels thick, local thickness {seen[name]}")
sys.exit(not (seen["layer"] == 6 and 10 <= seen["rod"] <= 11))
PYTHON
