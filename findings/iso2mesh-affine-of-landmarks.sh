#!/bin/sh
# iso2mesh 0.6.7 (its Python package): `affinemap`, the affine map by least squares of landmarks to others: the
# same ones, and eight of a limb that was moved by (1, 2, 3) mm and turned by 90 degrees.
# Guess: the identity and that motion: both fit exactly.
# Seen:  other maps, without a word: the landmarks laid on themselves end up to 118 mm off, the moved ones up
#        to 175 mm (98 and 101 with the matrix transposed). Its equations go point by point, their
#        right-hand sides coordinate by coordinate.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q iso2mesh==0.6.7 scipy==1.17.1 numpy==2.4.6 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import iso2mesh
import numpy as np

landmarks = np.array([
    [40.0, 0, 0], [0, 40, 0], [-40, 0, 0], [0, -40, 0], [30, 0, 100], [0, 30, 100], [-30, 0, 100], [0, -30, 100],
])
turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
seen = {}
for name, goal in (("the same", landmarks), ("moved and turned", landmarks @ turn.T + [1, 2, 3])):
    matrix, shift = iso2mesh.affinemap(landmarks, goal)
    off = (np.linalg.norm(landmarks @ m + np.ravel(shift) - goal, axis=1).max() for m in (matrix.T, matrix))
    exact = np.linalg.lstsq(np.c_[landmarks, np.ones(8)], goal, rcond=None)[0]
    least = np.linalg.norm(np.c_[landmarks, np.ones(8)] @ exact - goal, axis=1).max()
    seen[name] = [round(float(each)) for each in (*off, least)]
    print(name, "off by", seen[name][0], "mm, transposed", seen[name][1], "mm; by numpy's lstsq", seen[name][2], "mm")
sys.exit(seen != {"the same": [118, 98, 0], "moved and turned": [175, 101, 0]})
PYTHON
