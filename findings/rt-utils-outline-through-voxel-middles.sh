#!/bin/sh
# rt-utils 1.2.7: two masks, a bone of 10 x 10 pixels of 2 mm and a fascia of 10 x 1, made contours
# (RTSTRUCT) by rt-utils on a valid MR series.
# Guess: the contours are outlines: they enclose 400 and 40 mm2.
# Seen:  they go through the middles of the outermost pixels: 324 and 0 mm2. rt-utils gets 100 and 10 pixels
#        back, because it also fills what the line touches; a program that takes the contour for an outline
#        (planning, a surface, an area) loses half a pixel on every side, and the fascia altogether.
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

folder, PIXEL, N = Path(sys.argv[1]), 2.0, 40
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
    image.PixelSpacing, image.SliceThickness = [PIXEL, PIXEL], 4
    image.Rows, image.Columns, image.SamplesPerPixel, image.PixelRepresentation = N, N, 1, 0
    image.PhotometricInterpretation = "MONOCHROME2"
    image.BitsAllocated, image.BitsStored, image.HighBit = 16, 16, 15
    image.PixelData = np.zeros((N, N), np.uint16).tobytes()
    for name, uid in common.items():
        setattr(image, name, uid)
    image.save_as(folder / "series" / f"{k}.dcm", write_like_original=False)

masks = {name: np.zeros((N, N, 3), bool) for name in ("bone", "fascia")}
masks["bone"][12:22, 15:25, 1] = True
masks["fascia"][30, 15:25, 1] = True
structures = RTStructBuilder.create_new(str(folder / "series"))
for name, mask in masks.items():
    structures.add_roi(mask=mask, name=name)
structures.save(str(folder / "structures.dcm"))

again = RTStructBuilder.create_from(str(folder / "series"), str(folder / "structures.dcm"))
seen = {}
for name, structure in zip(masks, pydicom.dcmread(folder / "structures.dcm").ROIContourSequence, strict=True):
    x, y = np.array(structure.ContourSequence[0].ContourData, float).reshape(-1, 3)[:, :2].T
    area = abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2
    seen[name] = round(area, 1), int(again.get_roi_mask_by_name(name).sum())
    print(name, "contour", seen[name][0], "mm2; pixels read by rt-utils", seen[name][1])
sys.exit(seen != {"bone": (324, 100), "fascia": (0, 10)})
PYTHON
