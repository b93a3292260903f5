#!/bin/sh
# nibabel 5.4.2: a label map (0, 1, 2, 3; in floats, as get_fdata gives them) saved with the header of its
# MRI, whose values are int16.
# Guess: the labels are whole numbers that int16 holds: they are stored as they are, and `labels == 2` finds
#        its 64 voxels after reading.
# Seen:  nibabel spreads floats over all of int16 with a slope: 2 comes back as 1.9999999995, printed as 2.,
#        and no voxel equals 1, 2 or 3. As int16, the same labels are stored as they are.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q nibabel==5.4.2 2>/dev/null
"$folder/venv/bin/python" - "$folder/a.nii" <<'PYTHON'
import sys

import nibabel as nib
import numpy as np

path = sys.argv[1]
mri = nib.Nifti1Image(np.zeros((16, 16, 4), np.int16), np.eye(4))
labels = np.zeros((16, 16, 4))
labels[:, :4], labels[:4, 4:8], labels[4:8, 4:8] = 1, 2, 3
seen = {}
for kind in (np.int16, np.float64):
    nib.save(nib.Nifti1Image(labels.astype(kind), mri.affine, mri.header), path)
    back = nib.load(path)
    values = back.get_fdata()
    seen[kind.__name__] = tuple(int((values == k).sum()) for k in range(4))
    print(kind.__name__, "stored as", back.get_data_dtype(), "values", np.unique(values).tolist())
    print("   voxels equal to 0, 1, 2, 3:", *seen[kind.__name__])
given = tuple(int((labels == k).sum()) for k in range(4))
sys.exit(not (seen["int16"] == given == (640, 256, 64, 64) and seen["float64"] == (640, 0, 0, 0)))
PYTHON
