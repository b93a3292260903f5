#!/bin/sh
# rt-utils 1.2.7: a mask of pixels that are 1 mm wide and 2 mm high (Pixel Spacing, rows first: 2, 1), 11
# pixels wide and 6 high, made contours (RTSTRUCT) by rt-utils on a valid MR series.
# Guess: the contour, in mm, is where the mask is: its corners are the middles of pixels, from 15 to 25 mm
#        sideways and from 24 to 34 mm down.
# Seen:  the two spacings are taken for each other: 30 to 50 mm and 12 to 17 mm. rt-utils reads its own file
#        as it was, so that nothing shows it; every other program gets a bone of another shape in another
#        place.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q rt-utils==1.2.7 pydicom==2.4.5 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid
from rt_utils import RTStructBuilder

folder, N = Path(sys.argv[1]), 60
common = {each: generate_uid() for each in ("StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID")}
(folder / "series").mkdir()
for k in range(3):
    image = Dataset()
    image.file_meta = FileMetaDataset()
    image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    image.is_little_endian, image.is_implicit_VR = True, False
    image.SOPClassUID, image.SOPInstanceUID = MRImageStorage, generate_uid()
    image.Modality, image.PatientID, image.PatientName, image.InstanceNumber = "MR", "a", "a", k + 1
    image.PatientBirthDate = image.PatientSex = image.StudyDate = image.StudyTime = image.StudyID = ""
    image.ImageOrientationPatient, image.ImagePositionPatient = [1, 0, 0, 0, 1, 0], [0, 0, 4 * k]
    image.PixelSpacing, image.SliceThickness = [2, 1], 4  # between rows, between columns
    image.Rows, image.Columns, image.SamplesPerPixel, image.PixelRepresentation = N, N, 1, 0
    image.PhotometricInterpretation = "MONOCHROME2"
    image.BitsAllocated, image.BitsStored, image.HighBit = 16, 16, 15
    image.PixelData = np.zeros((N, N), np.uint16).tobytes()
    for name, uid in common.items():
        setattr(image, name, uid)
    image.save_as(folder / "series" / f"{k}.dcm", write_like_original=False)

bone = np.zeros((N, N, 3), bool)
bone[12:18, 15:26, 1] = True
structures = RTStructBuilder.create_new(str(folder / "series"))
structures.add_roi(mask=bone, name="bone")
structures.save(str(folder / "bone.dcm"))

contour = pydicom.dcmread(folder / "bone.dcm").ROIContourSequence[0].ContourSequence[0].ContourData
x, y = np.array(contour, float).reshape(-1, 3)[:, :2].T
structures = RTStructBuilder.create_from(str(folder / "series"), str(folder / "bone.dcm"))
again = structures.get_roi_mask_by_name("bone")
seen = [float(each) for each in (x.min(), x.max(), y.min(), y.max())], bool(np.array_equal(again, bone))
print("contour: sideways", *seen[0][:2], "down", *seen[0][2:], "mm; read by rt-utils as it was:", seen[1])
sys.exit(seen != ([30, 50, 12, 17], True))
PYTHON
