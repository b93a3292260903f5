#!/bin/sh
# metaimageio 1.3.2 and SimpleITK 2.5.7 (ITK 5.4): a label map of 64-bit integers, NumPy's default type, with a
# bone (2) in the lower slices and fat (1) in the uppermost, written as MetaImage by metaimageio.
# Guess: SimpleITK reads the labels where they were written.
# Seen:  it reads the first half of the file as 32-bit integers: the bone's rows are spread over twice as many,
#        with zeros between its voxels, and the fat is gone: 108 voxels of 0 and 12 of 2 for 66, 30 of 1 and 24
#        of 2. The file says MET_LONG, which has four bytes in MetaIO; eight bytes are MET_LONG_LONG. metaimageio
#        reads its own file as it was. No word is said by either.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q metaimageio==1.3.2 SimpleITK==2.5.7 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder/labels.mha" <<'PYTHON'
import sys

import metaimageio
import numpy as np
import SimpleITK as sitk

labels = np.zeros((4, 5, 6), np.int64)  # slices, rows, columns
labels[1:3, 1:4, 1:5], labels[3] = 2, 1
metaimageio.write(sys.argv[1], image=labels, ElementSpacing=(1, 1, 4))
again = metaimageio.read(sys.argv[1])[0]
image = sitk.ReadImage(sys.argv[1])
by_itk = sitk.GetArrayFromImage(image)
counts = [dict(zip(*(each.tolist() for each in np.unique(map_, return_counts=True)), strict=True))
          for map_ in (labels, again, by_itk)]
for name, count in zip(("written", "metaimageio", "SimpleITK"), counts, strict=True):
    print(name, count)
print("SimpleITK has taken them for a", image.GetPixelIDTypeAsString())
whole = {0: 66, 1: 30, 2: 24}
sys.exit(counts != [whole, whole, {0: 108, 2: 12}] or image.GetPixelID() != sitk.sitkInt32)
PYTHON
