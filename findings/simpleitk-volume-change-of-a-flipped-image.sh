#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4): a limb that is 10 % narrower along the patient's x (displacements -0.1 x, mm, as
# of a registration), on three grids: along the patient's axes, with x and y reversed (as of every NIfTI image
# in RAS), and turned by 30 degrees about z.
# Guess: DisplacementFieldJacobianDeterminant is the change of volume, 0.9 on each: displacements are in the
#        patient's frame, whatever the grid.
# Seen:  0.9, 1.1 and 0.913. The derivatives are taken along the rows of voxels, and the direction matrix is
#        passed over: with reversed axes what shrinks grows.
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

N, SPACING = 20, 2.0
c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
GRIDS = {"patient's axes": np.eye(3), "reversed": np.diag([-1.0, -1.0, 1.0]),
         "turned": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])}
voxels = np.stack(np.meshgrid(*[np.arange(N)] * 3, indexing="ij"), axis=-1)[..., ::-1]  # x, y, z of [z, y, x]
seen = {}
for name, direction in GRIDS.items():
    place = SPACING * voxels @ direction.T
    moved = np.zeros((N, N, N, 3))
    moved[..., 0] = -0.1 * place[..., 0]
    field = sitk.GetImageFromArray(moved, isVector=True)
    field.SetSpacing([SPACING] * 3)
    field.SetDirection(direction.ravel().tolist())
    # the field moves points as it should
    point = field.TransformIndexToPhysicalPoint((12, 9, 7))
    there = sitk.DisplacementFieldTransform(sitk.Image(field)).TransformPoint(point)
    assert np.allclose(there, np.array(point) * (0.9, 1, 1))
    seen[name] = round(sitk.DisplacementFieldJacobianDeterminant(field)[10, 10, 10], 3)
    print(name, "change of volume", seen[name], "true 0.9")
sys.exit(list(seen.values()) != [0.9, 1.1, 0.913])
PYTHON
