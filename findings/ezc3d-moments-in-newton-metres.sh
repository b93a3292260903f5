#!/bin/sh
# ezc3d 1.7.2: a force plate (type 2) in a valid C3D whose points are in mm and whose moments' channels state
# Nm (ANALOG:UNITS): a foot presses 700 N at x = 250, y = 320 mm of a plate of 400 x 600 mm.
# Guess: the units that the file states for the channels count: the centre of pressure is (250, 320).
# Seen:  the moments are taken for Nmm, as the points are in mm, and called so: (200.05, 300.02), almost the
#        middle of the plate, wherever the foot is. With moments in Nmm it is right. The moment at the socket
#        is wrong by 700 N times 54 mm.
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

FRAMES = 10
# corners of the plate, whose z axis points down, mm
CORNERS = np.array([[400.0, 0, 0], [0, 0, 0], [0, 600, 0], [400, 600, 0]]).T[:, :, None]
FROM_MIDDLE, FORCE = np.array([50.0, -20, 0]), np.array([0.0, 0, 700])  # in the plate's axes, mm and N


def pressure(path, unit, of_nmm):
    """Centre of pressure, mm, and the unit of moments by ezc3d, where the channels hold moments in `unit`."""
    recording = ezc3d.c3d()
    parameters = recording["parameters"]
    parameters["POINT"]["RATE"]["value"], parameters["POINT"]["UNITS"]["value"] = [100.0], ["mm"]
    parameters["POINT"]["LABELS"]["value"] = ("marker",)
    recording["data"]["points"] = np.ones((4, 1, FRAMES))
    parameters["ANALOG"]["RATE"]["value"] = [100.0]
    parameters["ANALOG"]["LABELS"]["value"] = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    parameters["ANALOG"]["UNITS"]["value"] = ["N"] * 3 + [unit] * 3
    moment = np.cross(FROM_MIDDLE, FORCE) * of_nmm
    recording["data"]["analogs"] = np.tile(np.r_[FORCE, moment][:, None], (1, FRAMES))[None]
    recording.add_parameter("FORCE_PLATFORM", "CORNERS", CORNERS)
    recording.add_parameter("FORCE_PLATFORM", "ORIGIN", np.zeros((3, 1)))
    plate = parameters["FORCE_PLATFORM"]
    whole = {"USED": [1], "TYPE": [2], "ZERO": [1, 0], "CHANNEL": np.arange(1, 7).reshape(6, 1)}
    for name, value in whole.items():
        plate[name] = {**plate["CORNERS"], "type": 2, "value": value}
    recording.write(str(path))
    found = ezc3d.c3d(str(path), extract_forceplat_data=True)["data"]["platform"][0]
    return [round(float(each), 1) for each in found["center_of_pressure"][:2, 0]], found["unit_moment"]


seen = {}
for unit, of_nmm in (("Nmm", 1.0), ("Nm", 1e-3)):
    seen[unit] = pressure(Path(sys.argv[1]) / "a.c3d", unit, of_nmm)
    print(f"moments in {unit}: centre of pressure {seen[unit][0]} mm, moments called {seen[unit][1]}")
off = seen["Nm"] == ([200.0, 300.0], "Nmm") or seen["Nm"] == ([200.1, 300.0], "Nmm")
sys.exit(not (off and seen["Nmm"] == ([250.0, 320.0], "Nmm")))
PYTHON
