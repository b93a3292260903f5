#!/bin/sh
# scikit-kinematics 0.10.4: turns of a shank given as three angles, made a quaternion by the package itself
# (`rotmat.seq2quat`) and taken apart again by its `quat.quat2seq`, in the same sequence.
# Guess: the angles come back: nautical (Rz Ry Rx) 120, 20, 10 degrees, as of a bent knee, and Euler (Rz Rx
#        Rz) 30, 20, 10.
# Seen:  nautical 60, 20, 10: angles beyond 90 degrees are folded back. Euler 150, 20, 10: the first angle
#        is counted from 180, at any angle. Both are other turns, by 60 and 120 degrees, and no word is
#        said. `rotmat.sequence` of the same turns gives 120, 20, 10, and 30, 20, 10.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q scikit-kinematics==0.10.4 numpy==2.4.6 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from skinematics import quat, rotmat

GIVEN = {"nautical": (120, 20, 10), "Euler": (30, 20, 10)}
seen = {}
for sequence, angles in GIVEN.items():
    turn = rotmat.seq2quat([angles], seq=sequence)
    back = quat.quat2seq(turn, seq=sequence)
    by_matrix = np.rad2deg(rotmat.sequence(quat.convert(turn, to="rotmat").reshape(3, 3), to=sequence))
    scalar = np.sum(turn * rotmat.seq2quat(back, seq=sequence))
    between = np.rad2deg(2 * np.arccos(min(abs(scalar), 1)))
    seen[sequence] = [np.round(each).astype(int).ravel().tolist() for each in (back, by_matrix, between)]
    print(sequence, angles, "-> quat2seq", *seen[sequence][:1], "rotmat.sequence", *seen[sequence][1:2],
          "degrees between the turns:", *seen[sequence][2])
sys.exit(seen != {"nautical": [[60, 20, 10], [120, 20, 10], [60]],
                  "Euler": [[150, 20, 10], [30, 20, 10], [120]]})
PYTHON
