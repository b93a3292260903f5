#!/bin/sh
# VTK 9.7.2: the surface of a ball in an image that is turned by 30 degrees about z (direction matrix), by
# three of VTK's filters for isosurfaces.
# Guess: the three surfaces lie around the ball's centre.
# Seen:  those of vtkMarchingCubes and vtkFlyingEdges3D do. vtkContourFilter, which pyvista's `contour` takes,
#        passes over the direction matrix: its surface has the same size and lies 22 mm beside the ball.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q vtk==9.7.2 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkContourFilter, vtkFlyingEdges3D, vtkMarchingCubes

SIZE, CENTRE = (30, 31, 32), (15, 15, 16)
cosine, sine = np.cos(np.pi / 6), np.sin(np.pi / 6)
image = vtkImageData()
image.SetDimensions(*SIZE)
image.SetSpacing(2, 2, 3)
image.SetOrigin(10, 20, -300)
image.SetDirectionMatrix((cosine, -sine, 0, sine, cosine, 0, 0, 0, 1))
k, j, i = np.indices(SIZE[::-1])
away = np.sqrt((2 * (i - CENTRE[0])) ** 2 + (2 * (j - CENTRE[1])) ** 2 + (3 * (k - CENTRE[2])) ** 2)
image.GetPointData().SetScalars(numpy_to_vtk((20 - away).ravel().astype(np.float32), deep=True))
centre = np.zeros(3)
image.TransformIndexToPhysicalPoint(*CENTRE, centre)
off = {}
for kind in (vtkMarchingCubes, vtkFlyingEdges3D, vtkContourFilter):
    drawn = kind()
    drawn.SetInputData(image)
    drawn.SetValue(0, 0.0)
    drawn.Update()
    points = vtk_to_numpy(drawn.GetOutput().GetPoints().GetData())
    off[kind.__name__] = float(np.linalg.norm(points.mean(axis=0) - centre))
    print(f"{kind.__name__}: {len(points)} points, middle {off[kind.__name__]:.1f} mm from the ball's centre")
marching, flying, contour = off.values()
sys.exit(not (marching < 0.2 and flying < 0.2 and contour > 15))
PYTHON
