#!/bin/sh
# neurokit2 0.3.0: a depth that grows by 10 mm/s, read from an ultrasound film of 25 frames/s for 10 s,
# resampled to the force's 1000 Hz by `signal_resample`, to be laid beside it.
# Guess: sample k is at k/1000 s.
# Seen:  by default ("interpolation") the first and the last frame are laid on the first and the last new
#        sample, so that time runs slower: the depth lags by 4 ms after 1 s, 20 ms after 5 s and 35 ms after
#        9 s (0.04, 0.2 and 0.35 mm), and the very last sample is 0. method="numpy" is right (but for the time
#        after the last frame). No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q neurokit2==0.3.0 numpy==2.2.0 scipy==1.17.1 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import neurokit2
import numpy as np

SPEED = 10.0  # mm/s
depth = SPEED * np.arange(250) / 25
seen = {}
for method in ("interpolation", "numpy"):
    new = neurokit2.signal_resample(depth, sampling_rate=25, desired_sampling_rate=1000, method=method)
    lag = np.arange(len(new)) / 1000 - new / SPEED
    seen[method] = [len(new), *(round(1000 * float(lag[at])) for at in (1000, 5000, 9000)), float(new[-1])]
    print(method, "lag after 1, 5 and 9 s:", *seen[method][1:4], "ms; last sample", seen[method][4], "mm")
sys.exit(not (seen["interpolation"] == [10000, 4, 20, 35, 0.0] and seen["numpy"][:4] == [10000, 0, 0, 0]))
PYTHON
