#!/bin/sh
# VTK 9.7.2 (pyvista 0.49.1) and SimpleITK 2.5.7: one image, turned by 30 degrees about z, saved as NIfTI and
# as MetaImage.
# Guess: `pyvista.read` places both alike: VTK's images have an origin and a direction matrix, and MetaImage's
#        are taken into them.
# Seen:  the NIfTI lies at the origin, not turned, with no word: qform and sform are passed over. The skin of
#        a label map lies 301 mm from the bones of another file of the same limb.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyvista==0.49.1 vtk==9.7.2 SimpleITK==2.5.7 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
import pyvista as pv
import SimpleITK as sitk

cosine, sine = np.cos(np.pi / 6), np.sin(np.pi / 6)
image = sitk.Image(12, 13, 14, sitk.sitkInt16)
image.SetSpacing((2.0, 2.0, 3.0))
image.SetOrigin((10.0, 20.0, -300.0))
image.SetDirection((cosine, -sine, 0, sine, cosine, 0, 0, 0, 1))
seen = {}
for ending in ("mha", "nii"):
    path = str(Path(sys.argv[1]) / f"a.{ending}")
    sitk.WriteImage(image, path)
    assert np.allclose(sitk.ReadImage(path).GetDirection(), image.GetDirection(), atol=1e-6)
    found = pv.read(path)
    is_turned = not np.allclose(found.direction_matrix, np.eye(3))
    seen[ending] = tuple(round(each) for each in found.origin), is_turned
    print(f"{ending}: first voxel at {seen[ending][0]} mm, {'' if is_turned else 'not '}turned")
apart = float(np.linalg.norm(np.subtract(seen["mha"][0], seen["nii"][0])))
print(f"{apart:.0f} mm apart")
sys.exit(seen != {"mha": ((10, 20, -300), True), "nii": ((0, 0, 0), False)})
PYTHON
