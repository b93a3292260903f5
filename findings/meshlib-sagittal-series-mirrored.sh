#!/bin/sh
# meshlib 3.1.4.297: a valid sagittal MR series, Image Orientation (0, 1, 0, 0, 0, -1), six slices from x = 0 to
# 20 mm (to the patient's left), numbered in this order, and the same numbered from left to right;
# VoxelsLoad.loadDicomFolder, and the place of each slice by the transform `xf` beside it.
# Guess: each slice lies where it says, in whatever order it is numbered.
# Seen:  numbered towards the left, they lie at 0 to -20 mm: slices keep their order, but are laid along the
#        cross product of rows and columns, which points to the right here. The limb is mirrored. Of axial
#        series both orders are right.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q meshlib==3.1.4.297 pydicom==3.0.2 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
from meshlib import mrmeshnumpy, mrmeshpy
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid



def write(folder, places, orientation):
    """A series whose slice k is 100 (k + 1) throughout; returns its folder."""
    folder.mkdir()
    common = {each: generate_uid() for each in ("StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID")}
    for k, place in enumerate(places):
        image = Dataset()
        image.file_meta = FileMetaDataset()
        image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        image.file_meta.MediaStorageSOPClassUID = image.SOPClassUID = MRImageStorage
        image.file_meta.MediaStorageSOPInstanceUID = image.SOPInstanceUID = generate_uid()
        image.Modality, image.PatientID, image.PatientName, image.InstanceNumber = "MR", "a", "a", k + 1
        image.SeriesNumber = 1
        image.ImageOrientationPatient, image.ImagePositionPatient = orientation, list(place)
        image.PixelSpacing, image.SliceThickness = [1.5, 1.5], 4
        image.Rows, image.Columns, image.SamplesPerPixel, image.PixelRepresentation = 24, 20, 1, 0
        image.PhotometricInterpretation = "MONOCHROME2"
        image.BitsAllocated, image.BitsStored, image.HighBit = 16, 16, 15
        image.PixelData = np.full((24, 20), 100 * (k + 1), np.uint16).tobytes()
        for name, uid in common.items():
            setattr(image, name, uid)
        image.save_as(folder / f"{k}.dcm", enforce_file_format=True)
    return folder


def found(folder):
    """Place along the axis of slices, mm, by the value of a slice."""
    read = mrmeshpy.VoxelsLoad.loadDicomFolder(str(folder), 2)
    values = np.asarray(mrmeshnumpy.getNumpy3Darray(read.vol))[0, 0]
    step = 1000 * read.vol.voxelSize.z  # sizes of voxels are in metres
    along = [getattr(getattr(read.xf.A, axis), "z") for axis in "xyz"]
    first = [getattr(read.xf.b, axis) for axis in "xyz"]
    places = np.array(first) + np.outer(np.arange(len(values)) * step, along)
    return {int(value): places[k].round(3) + 0.0 for k, value in enumerate(values)}


SERIES = {"sagittal, to the left": ([(4 * k, 0, 0) for k in range(6)], [0, 1, 0, 0, 0, -1]),
          "sagittal, to the right": ([(20 - 4 * k, 0, 0) for k in range(6)], [0, 1, 0, 0, 0, -1]),
          "axial, upwards": ([(0, 0, 4 * k) for k in range(6)], [1, 0, 0, 0, 1, 0]),
          "axial, downwards": ([(0, 0, 20 - 4 * k) for k in range(6)], [1, 0, 0, 0, 1, 0])}
seen = {}
for k, (name, (places, orientation)) in enumerate(SERIES.items()):
    there = found(write(Path(sys.argv[1]) / str(k), places, orientation))
    off = [float(np.abs(there[100 * (n + 1)] - place).max()) for n, place in enumerate(places)]
    seen[name] = max(off)
    print(name, "last slice at", there[600].tolist(), "in place of", places[-1])
sys.exit(list(seen.values()) != [40.0, 0.0, 0.0, 0.0])
PYTHON
