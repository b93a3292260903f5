#!/bin/sh
# lmfit 1.3.4: an indentation's force 0.8 depth^1.6, without noise, fitted with bounds: stiffness 0 to 10,
# power 1 to 3. The start of the stiffness lies inside its bounds (2), or on the upper one (10).
# Guess: the same from both starts, 0.8 and 1.6, or a failure: the fit has one minimum.
# Seen:  from the bound "leastsq", which `minimize` takes by default, ends at 0.88 +- 0.075 and 1.54 +-
#        0.018, success True: within the bounds values are a sine, whose slope is zero there. The power is
#        three standard errors off. "least_squares" finds 0.8 and 1.6 from both.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q lmfit==1.3.4 numpy==2.4.6 scipy==1.17.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import lmfit
import numpy as np

depth = np.linspace(0, 6, 13)  # mm
force = 0.8 * depth**1.6


def residual(parameters):
    return parameters["stiffness"] * depth ** parameters["power"] - force


seen = {}
for start in (2, 10):
    for method in ("leastsq", "least_squares"):
        parameters = lmfit.Parameters()
        parameters.add("stiffness", start, min=0, max=10)
        parameters.add("power", 1.2, min=1, max=3)
        result = lmfit.minimize(residual, parameters, method=method)
        found = [(round(each.value, 2), round(float(each.stderr), 3)) for each in result.params.values()]
        seen[start, method] = result.success, *found
        print("start", start, method, *seen[start, method])
exact = True, (0.8, 0.0), (1.6, 0.0)
wanted = {key: exact for key in seen} | {(10, "leastsq"): (True, (0.88, 0.075), (1.54, 0.018))}
sys.exit(seen != wanted)
PYTHON
