#!/bin/sh
# medpy 0.5.2 and SimpleITK 2.5.7: an image of 8 slices of 4 mm, in which two slices 20 mm apart are bright,
# resampled to slices of 1 mm by `medpy.filter.image.resample`, and saved with the header that it returns.
# Guess: the bright slices stay 20 mm apart, and where they were.
# Seen:  22.1 mm apart, moved by up to 2.6 mm: the first and last slice become the first and last of the new ones,
#        which are then 28/31 = 0.90 mm apart, but the header says 1. The fewer the slices, the longer the limb;
#        SimpleITK's resampling keeps the places.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q medpy==0.5.2 SimpleITK==2.5.7 numpy==2.4.6 scipy==1.17.1 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from medpy.filter.image import resample
from medpy.io import load, save

folder = Path(sys.argv[1])
values = np.zeros((8, 20, 20), np.float32)
values[[1, 6], 5:15, 5:15] = 100
image = sitk.GetImageFromArray(values)
image.SetSpacing((1, 1, 4))
sitk.WriteImage(image, folder / "leg.mha")

array, header = load(str(folder / "leg.mha"))
array, header = resample(array, header, (1, 1, 1), bspline_order=1)
save(array, str(folder / "medpy.mha"), header)
grid = sitk.Image((20, 20, 32), sitk.sitkFloat32)
by_itk = sitk.Resample(image, grid, sitk.Transform(), sitk.sitkLinear)

seen = {}
for name, each in (("given", image), ("medpy", sitk.ReadImage(folder / "medpy.mha")), ("SimpleITK", by_itk)):
    bright = sitk.GetArrayFromImage(each)[:, 10, 10]
    z = each.GetSpacing()[2] * np.arange(len(bright))
    low, high = (float(np.average(z[half], weights=bright[half])) for half in (z < 15, z >= 15))
    seen[name] = round(low, 1), round(high, 1)
    print(name, each.GetSize()[2], "slices of", each.GetSpacing()[2], "mm; bright at", *seen[name], "mm")
sys.exit(seen != {"given": (4, 24), "medpy": (4.4, 26.6), "SimpleITK": (4, 24)})
PYTHON
