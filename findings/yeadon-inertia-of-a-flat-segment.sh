#!/bin/sh
# yeadon 2.0.1 (inertia of body segments): a segment 300 mm long whose cross-section is a stadium, 160 mm wide and
# 40 mm deep, the same at both ends, by `StadiumSolid`, whose longer side lies along x.
# Guess: the moments of inertia of that body, by a sum over its cross-section: about x 0.0139, about y 0.0171,
#        about z 0.0037 kg m2.
# Seen:  about x 0.0154, 11 % too large; y and z are right. Where the depth of the rectangle between the round
#        ends belongs, its width is taken, so that of a thin slice Ix and Iy do not add up to Iz. Of segments
#        that are as deep as wide the error vanishes. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q yeadon==2.0.1 numpy==2.4.6 pyyaml==6.0.3 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from yeadon.solid import Stadium, StadiumSolid

RADIUS, HALF, LENGTH, DENSITY = 0.02, 0.06, 0.3, 1000.0  # m; the rectangle is 2 HALF wide and 2 RADIUS deep
ends = [Stadium(name, "thicknessradius", HALF, RADIUS) for name in ("Ls1: umbilicus", "Ls2: lowest front rib")]
solid = StadiumSolid("segment", DENSITY, *ends, LENGTH)

step = 1e-4
axes = [np.arange(-half + step / 2, half, step) for half in (HALF + RADIUS, RADIUS)]
x, y = np.meshgrid(*axes, indexing="ij")
inside = np.clip(np.abs(x) - HALF, 0, None) ** 2 + y**2 <= RADIUS**2
x, y = x[inside], y[inside]
part = DENSITY * LENGTH * step**2
mass = part * x.size
along = mass * LENGTH**2 / 12
summed = [part * (y**2).sum() + along, part * (x**2).sum() + along, part * (x**2 + y**2).sum()]
ratios = [round(float(a / b), 2) for a, b in zip(np.diag(solid.rel_inertia), summed, strict=True)]
print("mass", round(solid.mass, 3), "kg, by the sum", round(mass, 3))
for axis, value, expected, ratio in zip("xyz", np.diag(solid.rel_inertia), summed, ratios, strict=True):
    print(f"about {axis}: {value:.4f}, by the sum {expected:.4f} kg m2, ratio {ratio}")
sys.exit(not (abs(solid.mass / mass - 1) < 0.005 and ratios == [1.11, 1.0, 1.0]))
PYTHON
