#!/bin/sh
# imageio 2.38.1: a valid DICOM series of MR slices whose values 50, 100, 200 and 1000 are stored in 16
# bits, with a rescale slope of 1 and an intercept of 0, as many scanners write them.
# Guess: `volread` and `imread` with the format "DICOM" return the values, since slope and intercept change
#        nothing.
# Seen:  where a slope is stated, the smallest type is chosen anew, from the first slice, and takes 255 for
#        a value that eight signed bits hold: 200 becomes -56, also of one slice read alone, and in the
#        series 1000 becomes -24. No word is said. Without the slope, all four come back.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q imageio==2.38.1 pydicom==3.0.2 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import contextlib
import io
import sys
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid

VALUES = [50, 100, 200, 1000]


def write(folder, slope):
    names = "StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID"
    common = {each: generate_uid() for each in names}
    folder.mkdir()
    for k, value in enumerate(VALUES):
        image = Dataset()
        image.file_meta = FileMetaDataset()
        image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        image.SOPClassUID, image.SOPInstanceUID = MRImageStorage, generate_uid()
        image.Modality, image.PatientID, image.PatientName, image.SeriesNumber = "MR", "a", "a", 1
        image.InstanceNumber, image.ImageOrientationPatient = k + 1, [1, 0, 0, 0, 1, 0]
        image.ImagePositionPatient, image.PixelSpacing, image.SliceThickness = [0, 0, 4 * k], [2, 2], 4
        image.Rows, image.Columns, image.SamplesPerPixel = 4, 4, 1
        image.PhotometricInterpretation, image.PixelRepresentation = "MONOCHROME2", 0
        image.BitsAllocated, image.BitsStored, image.HighBit = 16, 16, 15
        image.PixelData = np.full((4, 4), value, np.uint16).tobytes()
        if slope:
            image.RescaleSlope, image.RescaleIntercept = 1, 0
        for name, uid in common.items():
            setattr(image, name, uid)
        image.save_as(folder / f"{k}.dcm", enforce_file_format=True)


seen = {}
for slope in (False, True):
    folder = Path(sys.argv[1]) / f"slope-{slope}"
    write(folder, slope)
    with contextlib.redirect_stdout(io.StringIO()):  # progress
        series = imageio.volread(folder, "DICOM")
        alone = [imageio.imread(folder / f"{k}.dcm", "DICOM") for k in range(len(VALUES))]
    seen[slope] = series[:, 0, 0].tolist(), [int(each[0, 0]) for each in alone]
    print("slope 1 stated:" if slope else "no slope stated:", *seen[slope])
sys.exit(seen != {False: (VALUES, VALUES), True: ([50, 100, -56, -24], [50, 100, -56, 1000])})
PYTHON
