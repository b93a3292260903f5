#!/bin/sh
# nii2dcm 0.1.6, nibabel 5.0.0 and SimpleITK 2.5.7: a NIfTI of 20 x 30 x 5 voxels of 0.977 x 0.977 x 4 mm,
# with an origin beside the middle as of one leg, made a DICOM series by nii2dcm.
# Guess: each voxel keeps its place: NIfTI counts x to the right and y to the front, DICOM to the left and
#        to the back, so that both change their sign.
# Seen:  the directions change their sign, the positions of the slices do not, and are one slice off: the
#        series lies 197 mm beside the image that it was made from, 4 mm of it along the leg, though it
#        looks right by itself. Pixels become 0.98 mm, rounded to two decimals. A label map of the same leg
#        lies elsewhere.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q nii2dcm==0.1.6 nibabel==5.0.0 SimpleITK==2.5.7 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import contextlib
import io
import sys
from pathlib import Path

import nibabel as nib
import numpy as np
import SimpleITK as sitk
from nii2dcm.run import run_nii2dcm

folder = Path(sys.argv[1])
values = np.zeros((20, 30, 5), np.uint16)
values[7, 4, 2] = 100
affine = np.array([[0.977, 0, 0, 90], [0, 0.977, 0, -40], [0, 0, 4, -200], [0, 0, 0, 1]])
nib.save(nib.Nifti1Image(values, affine), folder / "leg.nii")
(folder / "series").mkdir()
with contextlib.redirect_stdout(io.StringIO()):  # progress
    run_nii2dcm(folder / "leg.nii", folder / "series", "MR")

names = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder / "series"))
places = {}
for name, image in (("NIfTI", sitk.ReadImage(folder / "leg.nii")), ("DICOM", sitk.ReadImage(names))):
    k, j, i = (int(each[0]) for each in np.nonzero(sitk.GetArrayFromImage(image)))
    places[name] = np.array(image.TransformIndexToPhysicalPoint((i, j, k)))
    print(name, "the voxel of 100 lies at", places[name].round(2), "spacing", np.round(image.GetSpacing(), 4))
off = float(np.linalg.norm(places["DICOM"] - places["NIfTI"]))
print("off by", round(off, 2), "mm")
along = places["DICOM"][2] - places["NIfTI"][2]
sys.exit(not (round(off) == 197 and round(float(along), 3) == -4 and image.GetSpacing()[:2] == (0.98, 0.98)))
PYTHON
