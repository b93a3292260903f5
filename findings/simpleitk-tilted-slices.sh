#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4): a valid CT series with a tilted gantry: slices turned by 15 degrees about the x
# axis, the table moved by 10 mm along z between them; each slice states its position.
# Guess: voxels where the slices say, or a refusal: an image's axes are perpendicular, this stack's are not.
# Seen:  the slices are stacked along their normal. The first voxel of the eleventh lies at (0, -26, 97) in
#        place of (0, 0, 100), and no word is said: a straight bone leans by 15 degrees.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 pydicom==3.0.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from math import cos, radians, sin
from pathlib import Path

import SimpleITK as sitk
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

TILT, STEP, N = radians(15), 10, 11
common = {each: generate_uid() for each in ("StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID")}
paths = []
for k in range(N):
    image = Dataset()
    image.file_meta = FileMetaDataset()
    image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    image.SOPClassUID, image.SOPInstanceUID = CTImageStorage, generate_uid()
    image.Modality, image.PatientID, image.PatientName = "CT", "test", "test"
    image.StudyID, image.SeriesNumber, image.InstanceNumber = "1", 1, k + 1
    image.Rows, image.Columns, image.PixelSpacing, image.SliceThickness = 20, 24, [1, 1], STEP
    image.GantryDetectorTilt = 15
    image.ImageOrientationPatient = [1, 0, 0, 0, round(cos(TILT), 8), round(sin(TILT), 8)]
    image.ImagePositionPatient = [0, 0, STEP * k]
    image.BitsAllocated, image.BitsStored, image.HighBit, image.PixelRepresentation = 16, 16, 15, 1
    image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
    image.RescaleSlope, image.RescaleIntercept = 1, -1024
    image.PixelData = bytes(2 * 20 * 24)
    for name, uid in common.items():
        setattr(image, name, uid)
    paths.append(str(Path(sys.argv[1]) / f"{k}.dcm"))
    image.save_as(paths[-1], enforce_file_format=True)
stack = sitk.ReadImage(paths)
place = stack.TransformIndexToPhysicalPoint((0, 0, N - 1))
print("stated: 0 0 100; SimpleITK:", *(f"{each:.1f}" for each in place))
sys.exit([round(each, 1) for each in place] != [0.0, -25.9, 96.6])
PYTHON
