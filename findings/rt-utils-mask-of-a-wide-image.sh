#!/bin/sh
# rt-utils 1.2.7: contours (RTSTRUCT) on a DICOM series of 40 rows and 60 columns, made from a mask and read
# back.
# Guess: the mask comes back, 40 x 60 x slices, as it was given.
# Seen:  it has the shape 60 x 40, but is not turned: what lies beyond column 40 is cut off without a word. Of
#        a bone in columns 30 to 49 half is left. Square images come back whole.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q rt-utils==1.2.7 pydicom==3.0.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid
from rt_utils import RTStructBuilder


def series(folder, rows, columns, n=3):
    """A series of empty MR slices, 4 mm apart, pixels of 1 mm."""
    folder.mkdir()
    of_all = "StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID"
    common = {each: generate_uid() for each in of_all}
    for k in range(n):
        image = Dataset()
        image.file_meta = FileMetaDataset()
        image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        image.SOPClassUID, image.SOPInstanceUID = MRImageStorage, generate_uid()
        image.Modality, image.PatientID, image.PatientName, image.PatientSex = "MR", "test", "test", "O"
        image.StudyID, image.StudyDate, image.StudyTime, image.PatientBirthDate = "1", "20200101", "0000", ""
        image.SeriesNumber, image.InstanceNumber = 1, k + 1
        image.Rows, image.Columns, image.PixelSpacing, image.SliceThickness = rows, columns, [1, 1], 4
        image.ImageOrientationPatient, image.ImagePositionPatient = [1, 0, 0, 0, 1, 0], [0, 0, 4 * k]
        image.BitsAllocated, image.BitsStored, image.HighBit, image.PixelRepresentation = 16, 16, 15, 0
        image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
        image.PixelData = bytes(2 * rows * columns)
        for name, uid in common.items():
            setattr(image, name, uid)
        image.save_as(folder / f"{k}.dcm", enforce_file_format=True)
    return str(folder)


seen = {}
for rows, columns in ((40, 60), (60, 60)):
    contours = RTStructBuilder.create_new(series(Path(sys.argv[1]) / f"{rows}", rows, columns))
    mask = np.zeros((rows, columns, 3), bool)
    mask[10:30, 30:50] = True
    contours.add_roi(mask=mask, name="bone")
    back = contours.get_roi_mask_by_name("bone")
    seen[mask.shape] = back.shape, int(back.sum())
    print("given", mask.shape, int(mask.sum()), "voxels; back", *seen[mask.shape], "voxels")
sys.exit(seen != {(40, 60, 3): ((60, 40, 3), 600), (60, 60, 3): ((60, 60, 3), 1200)})
PYTHON
