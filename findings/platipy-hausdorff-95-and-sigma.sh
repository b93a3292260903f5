#!/bin/sh
# platipy 0.7.2: surface distances of two masks with voxels of 1 and of 0.5 mm: a ball of radius 15 mm, and
# the same ball with a rod that stands out by 15 mm.
# Guess: hausdorffDistance95 leaves the farthest twentieth out: 2.0 and 4.0 mm of both directions together;
#        sigmaSurfaceDistance is the standard deviation of the distances, 2.1 and 2.3 mm.
# Seen:  the percentile is taken of two numbers, the largest distances of the two directions: 14.3 and 14.4
#        mm. Sigma is not divided by the number of voxels: 144.8 and 327.3 mm, more the finer they are. The
#        mean is right.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q platipy==0.7.2 SimpleITK==2.5.7 numpy==2.4.6 2>/dev/null
MPLBACKEND=Agg MPLCONFIGDIR="$folder" "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import numpy as np
import SimpleITK as sitk
from platipy.imaging.label.comparison import compute_surface_metrics

NAMES = "hausdorffDistance95", "sigmaSurfaceDistance", "meanSurfaceDistance"


def masks(scale):
    """Voxels of 1 / scale mm."""
    k, j, i = np.indices((60 * scale, 40 * scale, 40 * scale)) / scale
    ball = (k - 25) ** 2 + (j - 20) ** 2 + (i - 20) ** 2 < 15**2
    rod = (abs(j - 20) < 3) & (abs(i - 20) < 3) & (k > 25) & (k < 55)
    images = [sitk.GetImageFromArray(each.astype(np.uint8)) for each in (ball, ball | rod)]
    for each in images:
        each.SetSpacing([1 / scale] * 3)
    return images


def distances(a, b):
    """Of the outermost voxels of each mask to the other's surface, both directions."""
    found = []
    for one, other in ((a, b), (b, a)):
        outermost = sitk.GetArrayFromImage(sitk.LabelContour(one)) > 0
        far = sitk.Abs(sitk.SignedMaurerDistanceMap(other, squaredDistance=False, useImageSpacing=True))
        found.append(sitk.GetArrayFromImage(far)[outermost])
    return np.concatenate(found)


seen = {}
for scale in (1, 2):
    a, b = masks(scale)
    by_platipy, each = compute_surface_metrics(a, b), distances(a, b)
    wanted = np.percentile(each, 95), each.std(), each.mean()
    got = [by_platipy[name] for name in NAMES]
    seen[scale] = [[round(float(x), 1) for x in row] for row in (got, wanted)]
    print(1 / scale, "mm: 95 %, sigma, mean: platipy", *seen[scale][0], "of the distances", *seen[scale][1])
sys.exit(seen != {1: [[14.3, 144.8, 0.4], [2.0, 2.1, 0.4]], 2: [[14.4, 327.3, 0.5], [4.0, 2.3, 0.5]]})
PYTHON
