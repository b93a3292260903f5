#!/bin/sh
# ezc3d 1.7.2: a recording of 70 s at 1 kHz (70 000 frames) written as C3D and read back.
# Guess: all frames come back, or the writer refuses: the header's count ends at 65535, and longer recordings
#        state theirs elsewhere (TRIAL:ACTUAL_END_FIELD, C3D User Guide).
# Seen:  the file holds all frames, but states 65535 as their number and nothing else: 65535 come back. The
#        last 4.5 s of a recording in the socket are lost, and no word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q ezc3d==1.7.2 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import ezc3d
import numpy as np

seen = {}
for n in (40_000, 70_000):
    path = Path(sys.argv[1]) / f"{n}.c3d"
    recording = ezc3d.c3d()
    recording["parameters"]["POINT"]["RATE"]["value"] = [1000.0]
    recording["parameters"]["POINT"]["LABELS"]["value"] = ("marker",)
    points = np.ones((4, 1, n))
    points[0, 0] = np.arange(n)
    recording["data"]["points"] = points
    recording.write(str(path))
    back = ezc3d.c3d(str(path))["data"]["points"].shape[2]
    seen[n] = back, path.stat().st_size > 16 * n
    print(f"written {n} frames ({path.stat().st_size} bytes), read {back}")
sys.exit(seen != {40_000: (40_000, True), 70_000: (65_535, True)})
PYTHON
