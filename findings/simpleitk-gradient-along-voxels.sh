#!/bin/sh
# SimpleITK 2.5.7 and itk 5.4.7: the gradient of one image that grows by 0.5 per mm towards the patient's right
# (-x), stored with x and y reversed, as every NIfTI image in RAS is.
# Guess: both return (-0.5, 0, 0), a vector of the patient's frame: the same filter, GradientImageFilter, of
#        the same library.
# Seen:  itk returns that, SimpleITK (0.5, 0, 0): it calls the filter with its own default, UseImageDirection
#        off. A beam's or a muscle's direction taken from it is reversed, and turned on an oblique image.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 itk-core==5.4.7 itk-filtering==5.4.7 itk-numerics==5.4.7 \
  numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import itk
import numpy as np
import SimpleITK as sitk

values = np.broadcast_to(np.arange(20, dtype=np.float32), (20, 20, 20)).copy()  # 1 per voxel of 2 mm
reversed_axes = np.diag([-1.0, -1.0, 1.0])
one = itk.image_from_array(values)
one.SetSpacing((2.0, 2.0, 2.0))
one.SetDirection(itk.matrix_from_array(reversed_axes))
other = sitk.GetImageFromArray(values)
other.SetSpacing((2.0, 2.0, 2.0))
other.SetDirection(reversed_axes.ravel().tolist())
seen = {"itk": itk.array_from_image(itk.gradient_image_filter(one))[10, 10, 10].tolist(),
        "SimpleITK": list(sitk.Gradient(other)[10, 10, 10]),
        "SimpleITK, told to": list(sitk.Gradient(other, useImageDirection=True)[10, 10, 10])}
for name, vector in seen.items():
    print(name, vector)
sys.exit([each[0] for each in seen.values()] != [-0.5, 0.5, -0.5])
PYTHON
