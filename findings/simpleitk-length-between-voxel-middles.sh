#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4): the length of a rod of 1 x 1 pixel of 1 mm in ten slices of 4 mm, by
# LabelShapeStatisticsImageFilter.
# Guess: its Feret diameter ("maximum distance between points of the object") is 40 mm, as its bounding box
#        and its volume, 40 mm3, are.
# Seen:  36 mm: from the middle of the first voxel to that of the last. The oriented bounding box has 40; the
#        longest axis of the ellipsoid of equal moments is another number again.
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

mask = np.zeros((20, 9, 9), np.uint8)
mask[5:15, 4, 4] = 1
image = sitk.GetImageFromArray(mask)
image.SetSpacing((1.0, 1.0, 4.0))
shape = sitk.LabelShapeStatisticsImageFilter()
shape.ComputeFeretDiameterOn()
shape.ComputeOrientedBoundingBoxOn()
shape.Execute(image)
seen = (shape.GetFeretDiameter(1), max(shape.GetOrientedBoundingBoxSize(1)), shape.GetPhysicalSize(1))
print("Feret diameter", seen[0], "longest side of the oriented box", seen[1], "mm; volume", seen[2], "mm3")
sys.exit(tuple(round(each, 3) for each in seen) != (36, 40, 40))
PYTHON
