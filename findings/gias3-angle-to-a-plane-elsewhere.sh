#!/bin/sh
# gias3 3.0 (gias3.common 3.0.0, musculoskeletal modelling): the angle between a plane of a bone and a direction
# that rises from it by 45 degrees, by `Plane.angleToVector` ("the angle between this plane and a vector").
# Guess: 45 degrees wherever the plane lies and however long the vector is.
# Seen:  45 where the plane goes through the image's origin; 39.3, 44.4 and 44.9 at 10, 100 and 500 mm from it,
#        and of the same direction 100 times as long 45, 0 and 33.7: the vector's tip is projected onto the plane as
#        a point, and the angle is taken at the origin. `angleToPlane` is right.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q gias3.common==3.0.0 numpy==2.2.6 scipy==1.17.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from gias3.common.geoprimitives import Plane

UP = np.array([0.0, 0.0, 1.0])
RISING = np.array([1.0, 0.0, 1.0])
seen = {}
for height in (0, 10, 100, 500):
    plane = Plane(height * UP, UP)
    angles = [plane.angleToVector(RISING), plane.angleToVector(100 * RISING), plane.angleToPlane(Plane(0 * UP, RISING))]
    seen[height] = [round(float(np.degrees(each)), 1) for each in angles]
    print(f"plane at {height} mm: {seen[height][0]} and {seen[height][1]} degrees; between planes", seen[height][2])
sys.exit(seen != {0: [45.0, 45.0, 45.0], 10: [39.3, 39.3, 45.0], 100: [44.4, 0.0, 45.0], 500: [44.9, 33.7, 45.0]})
PYTHON
