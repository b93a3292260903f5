#!/bin/sh
# VTK 9.7.2 and SimpleITK 2.5.7: a valid NRRD of one value per voxel, 5 x 6 x 7 voxels of 1.5 x 2.5 x 4 mm,
# as ITK (and 3D Slicer) write it: three axes of kind "domain".
# Guess: an image of 5 x 6 x 7 voxels.
# Seen:  vtkNrrdReader, which pyvista's `read` takes, makes one slice of 6 x 7 voxels of 2.5 x 4 mm with five
#        values each: the first axis became the components, and the spacings moved along. No word is said.
#        The same image as MetaImage is read rightly.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q vtk==9.7.2 SimpleITK==2.5.7 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from vtkmodules.vtkIOImage import vtkMetaImageReader, vtkNrrdReader

image = sitk.GetImageFromArray(np.zeros((7, 6, 5), np.int16))
image.SetSpacing((1.5, 2.5, 4))
seen = {}
for ending, kind in (("nrrd", vtkNrrdReader), ("mha", vtkMetaImageReader)):
    path = Path(sys.argv[1]) / f"a.{ending}"
    sitk.WriteImage(image, str(path))
    assert sitk.ReadImage(str(path)).GetSize() == image.GetSize()
    reader = kind()
    reader.SetFileName(str(path))
    reader.Update()
    found = reader.GetOutput()
    seen[ending] = found.GetDimensions(), found.GetSpacing(), found.GetNumberOfScalarComponents()
    print(f"{ending}: {image.GetSize()}, {image.GetSpacing()} mm by ITK; by VTK", *seen[ending])
sys.exit(seen != {"nrrd": ((6, 7, 1), (2.5, 4.0, 1.0), 5), "mha": ((5, 6, 7), (1.5, 2.5, 4.0), 1)})
PYTHON
