#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4): the signed distance map (SignedMaurerDistanceMap, with the image's spacing) of a
# block of 10 voxels of 1 mm by 3 slices of 4 mm: 10 mm wide and 12 mm high.
# Guess: the map is zero on the faces of the block: 10 and 12 mm apart.
# Seen:  it is zero in the middle of the outermost voxels of the block: 9 and 8 mm apart. A surface drawn at
#        zero, or an average of shapes made from such maps, loses half a voxel on every side, and nothing says
#        so. Outside, the distances are half a voxel too large.
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


def between_zeros(distances, spacing):
    """Distance of the first from the last place where values at voxel centres, interpolated, are zero."""
    inside = np.flatnonzero(distances <= 0)
    first, last = inside[0], inside[-1]
    before = distances[first] / (distances[first - 1] - distances[first])  # in voxels, at most 0
    after = distances[last] / (distances[last + 1] - distances[last])
    return float(spacing * (last - first - before - after))


values = np.zeros((11, 30, 30), np.uint8)
values[4:7, 10:20, 10:20] = 1
block = sitk.GetImageFromArray(values)
block.SetSpacing((1, 1, 4))
map_of_block = sitk.SignedMaurerDistanceMap(block, squaredDistance=False, useImageSpacing=True)
found = sitk.GetArrayFromImage(map_of_block)
wide, high = between_zeros(found[5, 15, :], 1.0), between_zeros(found[:, 15, 15], 4.0)
print(f"zeros {wide:g} mm apart across (block: 10), {high:g} mm apart along (block: 12)")
sys.exit((wide, high) != (9.0, 8.0))
PYTHON
