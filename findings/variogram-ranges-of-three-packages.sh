#!/bin/sh
# GSTools 1.7.0, PyKrige 1.7.3 and scikit-gstat 1.0.26: the correlation of a field (of stiffness, along a limb)
# at 20 mm, of the models "gaussian" and "exponential" with a length (len_scale, range) of 20 mm.
# Guess: one number for each model: at its range the correlation is exp(-1), or else what is left at the
#        "effective range", 5 %.
# Seen:  gaussian 0.456, 0.047 and 0.018: three lengths; exponential 0.368, 0.050 and 0.050. A length that one
#        package fitted is another model in the next: the gaussian's 20 mm of GSTools are 39 mm of PyKrige and
#        45 mm of scikit-gstat. The spherical model is the same in all.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q gstools==1.7.0 pykrige==1.7.3 scikit-gstat==1.0.26 numpy==2.4.6 2>/dev/null
MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import gstools
import numpy as np
from pykrige import variogram_models
from scipy.optimize import brentq
from skgstat import models

LENGTH = 20.0


def correlations(name, length, at):
    """Of GSTools, PyKrige and scikit-gstat, sill 1 and no nugget."""
    at = np.array([at])
    own = getattr(gstools, name.capitalize())(dim=3, var=1, len_scale=length).variogram(at)
    other = getattr(variogram_models, f"{name}_variogram_model")([1.0, length, 0.0], at)
    third = getattr(models, name)(at, length, 1.0)
    return [1 - float(each[0]) for each in (own, other, third)]


seen = {}
for name in ("gaussian", "exponential", "spherical"):
    seen[name] = [round(each, 3) for each in correlations(name, LENGTH, LENGTH)]
    print(name, "correlation at its length:", *seen[name])
at = 15.0
wanted = correlations("gaussian", LENGTH, at)[0]
same = [round(brentq(lambda length, k=k: correlations("gaussian", length, at)[k] - wanted, 5, 200))
        for k in (1, 2)]
print("the gaussian of GSTools with 20 mm: PyKrige's with", same[0], "mm, scikit-gstat's with", same[1])
sys.exit((seen, same) != ({"gaussian": [0.456, 0.047, 0.018], "exponential": [0.368, 0.05, 0.05],
                           "spherical": [0.0, 0.0, 0.0]}, [39, 45]))
PYTHON
