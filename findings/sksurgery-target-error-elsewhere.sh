#!/bin/sh
# scikit-surgerycore 0.8.3: the error to be expected at a target (TRE) 200 mm along a limb from five markers that
# are each found to 1 mm, by `compute_tre_from_fle` (Fitzpatrick 1998, equation 46), with the markers and the
# target where they are and moved together, as in another frame; and by 4000 trials of the package's own
# `orthogonal_procrustes`.
# Guess: one number, squared about 2.5 mm2: where the origin lies is nothing to the registration.
# Seen:  3.6 mm2, and 0.26 where the origin is 500 mm farther: instead of the distances from the axes through the
#        markers' centre, those from lines between the centre and the ends of unit vectors at the origin are
#        taken. Only with the centre at the origin it comes near (2.5). No word is said; an error of a sixteenth
#        of the true one looks like a good marker set.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q scikit-surgerycore==0.8.3 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from sksurgerycore.algorithms.errors import compute_tre_from_fle
from sksurgerycore.algorithms.procrustes import orthogonal_procrustes

MARKERS = np.array([[0, 0, 0], [80, 0, 0], [0, 120, 0], [0, 0, 60], [80, 120, 30.0]])
TARGET = np.array([[40, 60, -200.0]])
random = np.random.default_rng(1)


def by_trials(count=4000):
    squares = []
    for _ in range(count):
        found = MARKERS + random.normal(0, 1 / np.sqrt(3), MARKERS.shape)
        rotation, translation, _ = orthogonal_procrustes(found, MARKERS)
        squares.append(float(((rotation @ TARGET.T + translation - TARGET.T) ** 2).sum()))
    return np.mean(squares)


moves = {"as they are": np.zeros(3), "500 mm along the limb": np.array([0, 0, 500.0]),
         "centre at the origin": -MARKERS.mean(axis=0)}
seen = [float(compute_tre_from_fle(MARKERS + move, 1.0, TARGET + move)) for move in moves.values()]
for name, value in zip(moves, seen, strict=True):
    print(f"{name}: {value:.2f} mm2")
trials = by_trials()
print(f"by trials: {trials:.2f} mm2")
sys.exit(not (2.3 < trials < 2.7 and [round(value, 2) for value in seen] == [3.59, 0.26, 2.5]))
PYTHON
