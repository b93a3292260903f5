#!/bin/sh
# miseval 1.3.0: HausdorffDistance and BoundaryDistance of two masks in an image of 64 x 64 pixels: a square
# of 20 pixels, and the same square 30 pixels lower, 30 beside, and in its own place.
# Guess: a Hausdorff distance of 30, 30 and 0 pixels, as of SciPy's `directed_hausdorff` of the masks'
#        pixels, and a boundary distance of 0 in place.
# Seen:  the Hausdorff distance takes each row of the image for a point with 64 coordinates: 0 for the
#        square 30 pixels lower, 4.5 for the one beside. The boundary distance averages over all pairs of
#        points, not the nearest ones: 14.7 pixels from a mask to itself. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q miseval==1.3.0 numpy==2.4.6 scipy==1.17.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from miseval import evaluate
from scipy.spatial.distance import directed_hausdorff


def square(down, beside):
    mask = np.zeros((64, 64), np.uint8)
    mask[5 + down : 25 + down, 5 + beside : 25 + beside] = 1
    return mask


given = square(0, 0)
seen = {}
for name, other in (("lower", square(30, 0)), ("beside", square(0, 30)), ("in place", given)):
    by_miseval = [float(evaluate(given, other, metric=metric))
                  for metric in ("HausdorffDistance", "BoundaryDistance")]
    pixels = np.argwhere(given), np.argwhere(other)
    by_scipy = max(directed_hausdorff(*pixels)[0], directed_hausdorff(*pixels[::-1])[0])
    seen[name] = round(by_miseval[0], 1), round(by_miseval[1], 1), float(by_scipy)
    print(name, "Hausdorff, boundary distance by miseval, Hausdorff by SciPy:", *seen[name])
sys.exit(seen != {"lower": (0, 32.3, 30), "beside": (4.5, 32.3, 30), "in place": (0, 14.7, 0)})
PYTHON
