#!/bin/sh
# pyMechT 1.1.3 (fitting of soft-tissue tests): tissue with fibres spread by sigma about one direction
# (`StructModel`, a structural model, with A = B = 1), stretched by 1.2 along that direction; sigma 0.1 rad, which is
# the model's default, and 0.5.
# Guess: the integral over the fibres' directions that the model is described by: stresses (second
#        Piola-Kirchhoff) of 0.224 and 0.151.
# Seen:  0.054 and 0.151: the integral over half a turn is a sum at ten directions, none nearer to the middle
#        than 0.23 rad; fibres spread by 0.1 rad fall between them (their shares add up to 0.32, not 1), and with
#        a middle turned by 0.2 rad they count 1.7 times. A stiffness A fitted with the default is four times too
#        large. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pymecht==1.1.3 pyDOE==0.3.8 numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import math
import sys

import numpy as np
from pymecht.MatModel import StructModel
from scipy.integrate import quad

stretch = np.diag([1.2, 1.2**-0.5, 1.2**-0.5])
strain = (stretch @ stretch - np.eye(3)) / 2
model = StructModel()
defaults = model.param_default  # A 1, B 1, middle 0, sigma 0.1, nine tenths of the fibres spread about it


def integrated(middle, sigma, share, **_):
    whole = math.sqrt(2 * math.pi) * sigma * math.erf(math.pi / 2 / math.sqrt(2) / sigma)

    def stress(angle):
        fibre = np.array([math.cos(angle), math.sin(angle), 0])
        pull = math.exp(max(fibre @ strain @ fibre, 0)) - 1
        density = share * math.exp(-((angle - middle) ** 2) / 2 / sigma**2) / whole + (1 - share) / math.pi
        return density * pull * fibre[0] ** 2

    edges = [middle - 3 * sigma, middle, middle + 3 * sigma]
    return quad(stress, -math.pi / 2, math.pi / 2, points=edges, limit=500)[0]


seen = {}
for sigma, middle in ((0.1, 0.0), (0.1, 0.2), (0.5, 0.0)):
    values = {**defaults, "sigma": sigma, "mean_theta": middle}
    summed = float(model.secondPK(stretch, values)[0, 0])
    exact = integrated(middle, sigma, defaults["aniso_fraction"])
    seen[sigma, middle] = round(summed, 3), round(exact, 3)
    print("sigma", sigma, "middle", middle, "stress", *seen[sigma, middle][:1], "integrated", seen[sigma, middle][1])
sys.exit(defaults["sigma"] != 0.1
         or seen != {(0.1, 0.0): (0.054, 0.224), (0.1, 0.2): (0.345, 0.204), (0.5, 0.0): (0.151, 0.151)})
PYTHON
