#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4) and highdicom 0.28.2: a valid DICOM SEG of two segments, 12 slices 4 mm apart,
# pixels of 1.5 mm.
# Guess: a label map, or a mask of each segment, with the spacing that the file states for all frames.
# Seen:  one stack of the frames of both segments (12 of the skin, 5 of the bone below them), voxels of 1 x 1
#        x 1 mm, and no word: a limb of another size, with the bone beyond its end.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 highdicom==0.28.2 pydicom==3.0.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder/seg.dcm" <<'PYTHON'
import sys

import highdicom as hd
import numpy as np
import SimpleITK as sitk
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sr.codedict import codes
from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid

path = sys.argv[1]
common = {each: generate_uid() for each in ("StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID")}
images = []
for k in range(12):
    image = Dataset()
    image.file_meta = FileMetaDataset()
    image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    image.SOPClassUID, image.SOPInstanceUID = MRImageStorage, generate_uid()
    image.PatientBirthDate = image.AccessionNumber = image.ReferringPhysicianName = ""
    image.PositionReferenceIndicator = ""
    image.PatientID, image.PatientName, image.PatientSex = "test", "Test^Test", "O"
    image.StudyID, image.StudyDate, image.StudyTime = "1", "20200101", "000000"
    image.Modality, image.SeriesNumber, image.InstanceNumber = "MR", 1, k + 1
    image.Rows, image.Columns, image.PixelSpacing, image.SliceThickness = 20, 16, [1.5, 1.5], 4
    image.ImageOrientationPatient, image.ImagePositionPatient = [1, 0, 0, 0, 1, 0], [0, 0, 4 * k]
    image.BitsAllocated, image.BitsStored, image.HighBit, image.PixelRepresentation = 16, 16, 15, 0
    image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
    image.PixelData = bytes(2 * 20 * 16)
    for name, uid in common.items():
        setattr(image, name, uid)
    images.append(image)
masks = np.zeros((12, 20, 16, 2), np.uint8)
masks[:, 2:18, 2:14, 0] = 1
masks[3:8, 8:12, 6:10, 1] = 1
by_hand = hd.seg.SegmentAlgorithmTypeValues.MANUAL
described = [
    hd.seg.SegmentDescription(n, name, codes.SCT.Tissue, code, by_hand)
    for n, (name, code) in enumerate((("Skin", codes.SCT.Skin), ("Tibia", codes.SCT.Bone)), 1)
]
seg = hd.seg.Segmentation(
    images, masks, hd.seg.SegmentationTypeValues.BINARY, described, generate_uid(), 2, generate_uid(), 1,
    "maker", "model", "1", "1",
)
seg.save_as(path)
found = sitk.ReadImage(path)
stated = seg.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0]
print("stated:", list(stated.PixelSpacing), stated.SliceThickness, " frames:", seg.NumberOfFrames)
print("SimpleITK:", found.GetSize(), "voxels of", found.GetSpacing(), "mm")
sys.exit((found.GetSize(), found.GetSpacing()) != ((16, 20, 17), (1.0, 1.0, 1.0)))
PYTHON
