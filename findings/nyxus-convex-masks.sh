#!/bin/sh
# nyxus 0.11.0 (features of labels in images): a rectangle of 40 x 20 pixels and a disc of radius 15: the diameter
# of the circle of equal area (DIAMETER_EQUAL_AREA), the area of the convex hull (CONVEX_HULL_AREA), and the share
# of it that is filled (SOLIDITY).
# Guess: diameters of 31.9 and 30.0; both are convex: hulls of about 800 and 709 pixels, solidities of about 1,
#        as by scikit-image (0.96 of the disc).
# Seen:  diameters of 1018.6 and 902.7: 4/pi times the area, whose root is not taken; hulls of 1131 and 935
#        pixels, and solidities of 0.71 and 0.76: a limb's plain cross-section looks like one with deep folds. The
#        major axis of the disc, 30.07, is right. Mended in its repository, not in the newest release.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q nyxus==0.11.0 scikit-image==0.26.0 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
from nyxus import Nyxus
from skimage.measure import regionprops

NAMES = ["DIAMETER_EQUAL_AREA", "CONVEX_HULL_AREA", "SOLIDITY", "MAJOR_AXIS_LENGTH"]
rows, columns = np.mgrid[:100, :100]
labels = np.zeros((100, 100), np.uint32)
labels[10:30, 10:50] = 1
labels[(rows - 70) ** 2 + (columns - 50) ** 2 <= 15**2] = 2
features = Nyxus(NAMES).featurize(np.full_like(labels, 100), labels)
seen, expected = [], []
for region, (_, row) in zip(regionprops(labels), features.iterrows(), strict=True):
    seen.append([round(float(row[name]), 2) for name in NAMES])
    expected.append([round(float(each), 2) for each in (region.equivalent_diameter_area, region.area_convex,
                                                        region.solidity, region.axis_major_length)])
    print(*(f"{name} {a} (scikit-image {b});" for name, a, b in zip(NAMES, seen[-1], expected[-1], strict=True)))
sys.exit(seen != [[1018.59, 1131.0, 0.71, 46.19], [902.73, 935.0, 0.76, 30.07]])
PYTHON
