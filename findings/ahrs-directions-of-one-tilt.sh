#!/bin/sh
# ahrs 0.4.0: a sensor at rest on a shank, turned by 30 degrees about its x axis (x to the north, y to the east,
# z down, gravity and a magnetic field with a dip of 60 degrees in the signs by which `Tilt` finds the turn);
# its orientation by seven of the package's estimators, as a quaternion or a matrix.
# Guess: 30 degrees about x of all, or -30 of all: one package, one meaning of an orientation.
# Seen:  30 by Tilt, FAMC, Madgwick and Mahony (Mahony with a heading of 90 degrees for north), -30 by SAAM,
#        AQUA and TRIAD, whose results turn from the world to the sensor. A bent knee becomes an overstretched
#        one, and two bones by two estimators are 60 degrees off. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q ahrs==0.4.0 numpy==2.2.0 scipy==1.17.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from ahrs import filters
from scipy.spatial.transform import Rotation

DIP = np.radians(60)
turned = Rotation.from_euler("x", 30, degrees=True)
acceleration = np.tile(turned.inv().apply([0, 0, 9.81]), (3000, 1))  # m/s2
field = np.tile(turned.inv().apply([50 * np.cos(DIP), 0, 50 * np.sin(DIP)]), (3000, 1))  # microtesla
still = np.zeros((3000, 3))


def angles(orientation):
    """About x, y and z, of the last sample's quaternion (scalar first) or matrix."""
    last = np.asarray(orientation)[-1]
    turn = Rotation.from_matrix(last) if last.ndim == 2 else Rotation.from_quat(last, scalar_first=True)
    return [int(each) for each in turn.as_euler("xyz", degrees=True).round()]


found = {"TRIAD": filters.TRIAD(acceleration[:2], field[:2]).A}
for name in ("Tilt", "FAMC", "SAAM"):
    found[name] = getattr(filters, name)(acc=acceleration[:2], mag=field[:2]).Q
for name in ("Madgwick", "Mahony", "AQUA"):
    found[name] = getattr(filters, name)(gyr=still, acc=acceleration, mag=field).Q
seen = {name: angles(each) for name, each in found.items()}
for name, each in sorted(seen.items()):
    print(f"{name}: {each[0]} degrees about x; {each[1]} and {each[2]} about y and z")
sys.exit({name: each[0] for name, each in seen.items()} != {
    "Tilt": 30, "FAMC": 30, "Madgwick": 30, "Mahony": 30, "SAAM": -30, "AQUA": -30, "TRIAD": -30})
PYTHON
