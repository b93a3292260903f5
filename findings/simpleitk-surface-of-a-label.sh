#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4): surface area ("perimeter") and roundness of labels by
# LabelShapeStatisticsImageFilter, voxels of 1 x 1 x 4 mm as of an MRI of a limb.
# Guess: the area of a ball and of a limb-like cylinder (radius 40, length 100 mm, along the slices' normal)
#        is right to a few per cent; a roundness is at most 1.
# Seen:  the ball's is right (-0 %), the cylinder's is 19 % too small, and its roundness 1.07. With voxels of
#        1 mm it is 5 % too small. No word tells that the estimate depends on shape and spacing.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import SimpleITK as sitk

WIDE = 130  # mm, of the image
statistics = sitk.LabelShapeStatisticsImageFilter()
statistics.ComputePerimeterOn()
seen = {}
for thick in (1, 4):
    k, j, i = np.indices((WIDE // thick + 1, WIDE, WIDE))
    x, y, z = i - WIDE / 2, j - WIDE / 2, thick * k - WIDE / 2
    ball, across = x**2 + y**2 + z**2 < 50**2, x**2 + y**2 < 40**2
    shapes = {"ball": (ball, 4 * np.pi * 50**2), "cylinder": (across & (abs(z) < 50), 2 * np.pi * 40 * 140)}
    for name, (mask, area) in shapes.items():
        label = sitk.GetImageFromArray(mask.astype(np.uint8))
        label.SetSpacing((1, 1, thick))
        statistics.Execute(label)
        error, roundness = statistics.GetPerimeter(1) / area - 1, statistics.GetRoundness(1)
        seen[name, thick] = round(100 * error), round(roundness, 2)
        print(f"slices of {thick} mm, {name}: area {error:+.1%}, roundness {roundness:.2f}")
wanted = {("ball", 1): 0, ("cylinder", 1): -5, ("ball", 4): 0, ("cylinder", 4): -19}
good = all(abs(seen[key][0] - error) <= 1 for key, error in wanted.items())
sys.exit(not (good and seen["cylinder", 4][1] > 1.05))
PYTHON
