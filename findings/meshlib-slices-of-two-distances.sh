#!/bin/sh
# meshlib 3.1.4.297: a valid MR series whose slices are 4 mm apart in its first half and 8 mm in its second,
# 60 mm from the first to the last, read by VoxelsLoad.loadDicomFolder.
# Guess: the slices lie where they say, or a word is said: one distance cannot be true of both halves.
# Seen:  eleven slices of 4 mm, 40 mm: the distance of the first two is taken for all, and no word is said. A
#        limb is a third shorter, and so is one with a slice that was not copied.
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
from meshlib import mrmeshpy
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


places = [(0, 0, 4 * k) for k in range(6)] + [(0, 0, 20 + 8 * k) for k in range(1, 6)]
read = mrmeshpy.VoxelsLoad.loadDicomFolder(str(write(Path(sys.argv[1]) / "a", places, [1, 0, 0, 0, 1, 0])), 2)
step, n = 1000 * read.vol.voxelSize.z, read.vol.dims.z  # sizes of voxels are in metres
print(n, "slices of", round(step, 3), "mm:", round((n - 1) * step, 3), "mm; by their places 60 mm")
sys.exit((n, round(step, 3)) != (11, 4))
PYTHON
