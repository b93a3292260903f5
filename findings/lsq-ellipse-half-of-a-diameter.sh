#!/bin/sh
# lsq-ellipse 2.2.1: ellipses fitted (`as_parameters`) to the outline of a limb's cross-section of 120 x 80 mm,
# whose long axis lies at 20 and at 120 degrees to x, in the middle of the picture and elsewhere.
# Guess: as described: width and height are total lengths (diameters), and phi is the angle from x to the long
#        axis: 120 and 80 mm, 20 and 120 degrees.
# Seen:  60 and 40 mm: half of them; an area from them is a quarter, a girth a half. Where the same outline lies
#        decides which of the two is the width, and phi is the angle of the width, 20 or 110 degrees, also where
#        that is the short axis. (The example on its page draws twice the width, but says nothing.)
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q lsq-ellipse==2.2.1 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from ellipse import LsqEllipse

angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
outline = np.c_[60 * np.cos(angle), 40 * np.sin(angle)]
seen = {}
for place in ((0, 0), (10, 5)):
    for turn in (20, 120):
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        _, width, height, phi = LsqEllipse().fit(outline @ [[c, s], [-s, c]] + place).as_parameters()
        seen[place, turn] = [round(float(each)) for each in (width, height, np.degrees(phi))]
        print(f"at {place} mm, long axis at {turn} degrees: width, height, phi", *seen[place, turn])
sys.exit(seen != {((0, 0), 20): [40, 60, 110], ((0, 0), 120): [40, 60, 30],
                  ((10, 5), 20): [60, 40, 20], ((10, 5), 120): [60, 40, 120]})
PYTHON
