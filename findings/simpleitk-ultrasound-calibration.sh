#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4): a valid DICOM ultrasound image whose region is calibrated (Sequence of
# Ultrasound Regions: 0.02 cm a pixel in both directions); ultrasound images have no Pixel Spacing.
# Guess: pixels of 0.2 mm, or a word that the size is not known.
# Seen:  pixels of 1 x 1 mm, and no word: tissue 20 mm thick comes out as 100 mm.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 pydicom==3.0.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import SimpleITK as sitk
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, UltrasoundImageStorage, generate_uid

CENTIMETRES = 3  # as a code of Physical Units X Direction
image, region = Dataset(), Dataset()
image.file_meta = FileMetaDataset()
image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
image.SOPClassUID, image.SOPInstanceUID = UltrasoundImageStorage, generate_uid()
image.StudyInstanceUID, image.SeriesInstanceUID = generate_uid(), generate_uid()
image.Modality, image.PatientID, image.PatientName = "US", "test", "test"
image.StudyID, image.SeriesNumber, image.InstanceNumber = "1", 1, 1
image.Rows, image.Columns, image.SamplesPerPixel, image.PhotometricInterpretation = 200, 160, 1, "MONOCHROME2"
image.BitsAllocated, image.BitsStored, image.HighBit, image.PixelRepresentation = 8, 8, 7, 0
region.RegionSpatialFormat, region.RegionDataType, region.RegionFlags = 1, 1, 2  # 2D, tissue
region.RegionLocationMinX0, region.RegionLocationMinY0 = 0, 0
region.RegionLocationMaxX1, region.RegionLocationMaxY1 = 159, 199
region.PhysicalUnitsXDirection = region.PhysicalUnitsYDirection = CENTIMETRES
region.PhysicalDeltaX = region.PhysicalDeltaY = 0.02
image.SequenceOfUltrasoundRegions = [region]
image.PixelData = bytes(200 * 160)
path = Path(sys.argv[1]) / "a.dcm"
image.save_as(path, enforce_file_format=True)
spacing = sitk.ReadImage(str(path)).GetSpacing()[:2]
print(f"stated: 0.2 x 0.2 mm; SimpleITK: {spacing[0]:g} x {spacing[1]:g} mm")
sys.exit(spacing != (1.0, 1.0))
PYTHON
