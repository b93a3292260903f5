#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4): distances from a cube of 12 mm in voxels of 1 x 1 x 4 mm, by
# ApproximateSignedDistanceMap, whose description tells of chamfer distances, not as exact as Euclidean ones.
# Guess: some per cent off: about 9.5 mm for a voxel 9.5 mm beside the cube, and 10 mm for one 10 mm above it.
# Seen:  8.8 and 3.9. From the second voxel on it counts voxels (0.93 each), whatever the image's spacing is.
#        SignedMaurerDistanceMap, told to use the spacing, gives 10 and 12: to the middle of the cube's
#        outermost voxels.
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

values = np.zeros((13, 42, 42), np.uint8)
values[5:8, 15:27, 15:27] = 1
cube = sitk.GetImageFromArray(values)
cube.SetSpacing((1, 1, 4))
# voxels whose middle is 9.5 mm (x) and 10 mm (z) from the cube's faces
beside, above = (6, 21, 36), (10, 21, 21)
seen = {}
for name, found in (
    ("approximate", sitk.ApproximateSignedDistanceMap(cube, insideValue=1, outsideValue=0)),
    ("Maurer", sitk.SignedMaurerDistanceMap(cube, squaredDistance=False, useImageSpacing=True)),
):
    distances = sitk.GetArrayFromImage(found)
    seen[name] = float(distances[beside]), float(distances[above])
    print(f"{name}: {seen[name][0]:.1f} beside the cube, {seen[name][1]:.1f} above it")
beside_cube, above_cube = seen["approximate"]
good = abs(beside_cube - 8.8) < 0.1 and abs(above_cube - 3.9) < 0.1
sys.exit(not (good and seen["Maurer"] == (10.0, 12.0)))
PYTHON
