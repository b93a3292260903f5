#!/bin/sh
# nibabel 5.4.2 and ITK 5.4 (SimpleITK 2.5.7): one valid NIfTI whose header states metres (xyzt_units 1).
# Guess: both readers give the same size: millimetres, or the file's own unit.
# Seen:  ITK converts to mm; nibabel's affine and zooms stay in the file's unit, also when it is metres. The
#        same voxels are 2 mm wide in one and 0.002 in the other, and the limb a thousand times smaller.
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
seen = {}
for unit, size in (("mm", 2.0), ("meter", 0.002)):
    image = nib.Nifti1Image(np.zeros((5, 6, 7), np.uint8), np.diag([size, size, size, 1.0]))
    image.header.set_xyzt_units(unit)
    nib.save(image, path)
    by_nibabel, by_itk = nib.load(path).affine[0, 0], sitk.ReadImage(path).GetSpacing()[0]
    seen[unit] = round(float(by_nibabel), 6), round(by_itk, 6)
    print(f"voxels of 2 mm, header in {unit}: {seen[unit][0]:g} (nibabel), {seen[unit][1]:g} (ITK)")
sys.exit(seen != {"mm": (2.0, 2.0), "meter": (0.002, 2.0)})
PYTHON
