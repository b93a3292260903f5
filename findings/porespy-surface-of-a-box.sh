#!/bin/sh
# porespy 3.2.0: surface area and sphericity of regions by `regionprops_3D`: a ball of radius 20 voxels, a layer
# of 20 x 20 x 4 and a block of 20 x 20 x 20 voxels.
# Guess: near 5027, 1120 and 2400 (5 to 10 % less where corners are rounded, as the mask is blurred first), as of
#        the package's `region_surface_areas`; a sphericity is at most 1, that of a ball.
# Seen:  6096 of the ball (+21 %), 6.9 of the layer and of the block; sphericities 0.82, 95 and 279: the mask is
#        blurred as truth values, which stay 0 or 1, and cut at level 0. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q porespy==3.2.0 scikit-image==0.26.0 numpy==2.2.6 scipy==1.17.1 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import porespy

i, j, k = np.indices((60, 60, 60))
box = (i >= 20) & (i < 40) & (j >= 20) & (j < 40) & (k >= 20)
bodies = {"ball": (i - 30) ** 2 + (j - 30) ** 2 + (k - 30) ** 2 <= 20**2, "layer": box & (k < 24),
          "block": box & (k < 40)}
seen = {}
for name, body in bodies.items():
    labels = body.astype(int)
    region = porespy.metrics.regionprops_3D(labels)[0]
    other = porespy.metrics.region_surface_areas(labels)[0]
    seen[name] = [round(float(each), digits) for each, digits in
                  ((region.surface_area, 1), (region.sphericity, 2), (other, 0))]
    print(f"{name}: surface {seen[name][0]}, sphericity {seen[name][1]}; region_surface_areas {seen[name][2]}")
sys.exit(seen != {"ball": [6096.2, 0.82, 5068.0], "layer": [6.9, 95.49, 1037.0], "block": [6.9, 279.21, 2288.0]})
PYTHON
