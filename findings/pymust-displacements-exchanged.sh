#!/bin/sh
# PyMUST 0.1.9 (ultrasound toolbox): speckle tracking (`sptrack`) between two images of which the second is moved
# by 6 pixels downwards (away from the probe) and 2 to the left.
# Guess: the first result is Di, the second Dj, as described: i is vertical and grows from top to bottom.
# Seen:  the first is -2, the second 6, and the points' coordinates are exchanged alike. The axial
#        displacement of an indentation is taken for the lateral one, and the other way round. Its own tutorials
#        unpack Di first; mended in its repository, not in the newest release.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q PyMUST==0.1.9 numpy==2.2.6 scipy==1.17.1 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import pymust
from pymust import utils
from scipy import ndimage

image = ndimage.gaussian_filter(np.random.default_rng(3).normal(size=(256, 256)), 3.0)
seen = []
for down, right in ((6, -2), (0, 4)):
    settings = utils.Param()
    settings.winsize = np.array([[64, 64], [32, 32]])
    found = pymust.sptrack(np.dstack([image, np.roll(image, (down, right), axis=(0, 1))]), settings)
    seen.append([round(float(np.median(each)), 1) + 0.0 for each in found[:2]])
    print(f"moved down by {down} and to the right by {right}: first result {seen[-1][0]}, second {seen[-1][1]}")
sys.exit(seen != [[-2.0, 6.0], [4.0, 0.0]])
PYTHON
