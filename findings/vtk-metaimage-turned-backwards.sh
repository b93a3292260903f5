#!/bin/sh
# VTK 9.7.2 and ITK 5.4 (SimpleITK 2.5.7): one valid MetaImage, as ITK writes it, turned by 30 degrees about
# z.
# Guess: both place its voxels alike, since VTK's images have a direction matrix.
# Seen:  VTK takes the lines of TransformMatrix for lines of the matrix; ITK writes and reads an axis in each.
#        In VTK the image is turned by -30 degrees: the last voxel lies 33 mm off.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q vtk==9.7.2 SimpleITK==2.5.7 2>/dev/null
"$folder/venv/bin/python" - "$folder/a.mha" <<'PYTHON'
import sys

import numpy as np
import SimpleITK as sitk
from vtkmodules.vtkIOImage import vtkMetaImageReader

path = sys.argv[1]
cosine, sine = np.cos(np.pi / 6), np.sin(np.pi / 6)
image = sitk.Image(12, 13, 14, sitk.sitkInt16)
image.SetSpacing((2.0, 2.0, 3.0))
image.SetOrigin((10.0, 20.0, -300.0))
image.SetDirection((cosine, -sine, 0, sine, cosine, 0, 0, 0, 1))
sitk.WriteImage(image, path)
by_itk = np.array(sitk.ReadImage(path).TransformIndexToPhysicalPoint((11, 12, 13)))
reader = vtkMetaImageReader()
reader.SetFileName(path)
reader.Update()
by_vtk = np.zeros(3)
reader.GetOutput().TransformIndexToPhysicalPoint(11, 12, 13, by_vtk)
back = image.GetOrigin() + np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]) @ (22, 24, 39)
apart = np.linalg.norm(by_vtk - by_itk)
print("last voxel, ITK:", by_itk.round(1), " VTK:", by_vtk.round(1), " apart:", apart.round(1), "mm")
sys.exit(not (np.allclose(by_vtk, back, atol=1e-3) and apart > 30))
PYTHON
