#!/bin/sh
# nibabel 5.4.2 and ITK 5.4 (SimpleITK 2.5.7): one valid NIfTI with qform (code 1) and sform (code 2) that differ.
# Guess: both readers place it by the sform, which the format lists as the more general of the two.
# Seen:  nibabel takes the sform whatever its code; ITK takes the sform only where its code is 1 (scanner), else the
#        qform. The same file lies 3 mm apart in the two, and no reader says so.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q nibabel==5.4.2 SimpleITK==2.5.7 2>/dev/null
"$folder/venv/bin/python" - "$folder/a.nii" <<'PYTHON'
import sys

import nibabel as nib
import numpy as np
import SimpleITK as sitk

path = sys.argv[1]
moved = np.diag([1.0, 1.0, 8.0, 1.0])
moved[0, 3] = 3.0
seen = {}
for code in (1, 2):
    image = nib.Nifti1Image(np.zeros((5, 6, 7), np.float32), np.diag([1.0, 1.0, 8.0, 1.0]))
    image.set_qform(np.diag([1.0, 1.0, 8.0, 1.0]), code=1)
    image.set_sform(moved, code=code)
    nib.save(image, path)
    by_nibabel = nib.load(path).affine[0, 3]
    by_itk = -sitk.ReadImage(path).GetOrigin()[0]  # ITK is LPS
    seen[code] = by_nibabel, by_itk
    print(f"sform code {code}: first voxel at x = {by_nibabel:g} mm (nibabel), {by_itk:g} mm (ITK)")
sys.exit(seen != {1: (3.0, 3.0), 2: (3.0, 0.0)})
PYTHON
