#!/bin/sh
# nii2dcm 0.1.6 and nibabel 5.0.0: three NIfTI images made DICOM series: a CT in Hounsfield units (-1000,
# -100, 0, 300), a map of shear-wave speed in m/s (1.25, 2.75, 3.5, 0), and an MRI of whole numbers (0 to
# 900).
# Guess: DICOM's rescale slope and intercept, which nii2dcm writes, say what the stored values mean: all
#        come back, or are refused.
# Seen:  slope 1 and intercept 0 always: only the MRI comes back. Of the CT, air is 64536 and fat 65436; of
#        the speeds, the whole metres per second are left: 1, 2, 3. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q nii2dcm==0.1.6 nibabel==5.0.0 pydicom==2.3.0 numpy==1.23.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import contextlib
import io
import sys
from pathlib import Path

import nibabel as nib
import numpy as np
import pydicom
from nii2dcm.run import run_nii2dcm

IMAGES = {"CT": (-1000, -100, 0, 300), "speeds": (1.25, 2.75, 3.5, 0), "MRI": (0, 100, 500, 900)}
seen = {}
for name, values in IMAGES.items():
    folder = Path(sys.argv[1]) / name
    folder.mkdir()
    image = np.empty((4, 3, 2), np.float32)
    image[...] = np.array(values)[:, None, None]
    nib.save(nib.Nifti1Image(image, np.diag([1, 1, 4, 1])), folder / "a.nii")
    with contextlib.redirect_stdout(io.StringIO()):  # progress
        run_nii2dcm(folder / "a.nii", folder, "MR")
    made = pydicom.dcmread(folder / "IM_0001.dcm")
    seen[name] = (made.pixel_array[:, 0] * float(made.RescaleSlope) + float(made.RescaleIntercept)).tolist()
    print(name, values, "->", seen[name])
sys.exit(seen != {"CT": [64536, 65436, 0, 300], "speeds": [1, 2, 3, 0], "MRI": [0, 100, 500, 900]})
PYTHON
