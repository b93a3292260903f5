#!/bin/sh
# meshlib 3.1.4.297: a valid MR series, pixels of 1.5 mm, slices 4 mm apart, the first pixel at (120, -80, 300)
# mm in the patient, read by VoxelsLoad.loadDicomFolder.
# Guess: voxels of 1.5 x 1.5 x 4 and a place of (120, -80, 300), mm as in DICOM.
# Seen:  voxels of 0.0015 x 0.0015 x 0.004: metres; but the transform `xf` beside them has its shift in mm. Put
#        together, a limb becomes a speck at the right place; with surfaces of other files (mm), its volume is
#        too small by 10^9. No word is said.
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

series = Path(sys.argv[1]) / "series"
series.mkdir()
common = {each: generate_uid() for each in ("StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID")}
for k in range(6):
    image = Dataset()
    image.file_meta = FileMetaDataset()
    image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    image.file_meta.MediaStorageSOPClassUID = image.SOPClassUID = MRImageStorage
    image.file_meta.MediaStorageSOPInstanceUID = image.SOPInstanceUID = generate_uid()
    image.Modality, image.PatientID, image.PatientName, image.InstanceNumber = "MR", "a", "a", k + 1
    image.SeriesNumber = 1
    image.ImageOrientationPatient, image.ImagePositionPatient = [1, 0, 0, 0, 1, 0], [120, -80, 300 + 4 * k]
    image.PixelSpacing, image.SliceThickness, image.SpacingBetweenSlices = [1.5, 1.5], 4, 4
    image.Rows, image.Columns, image.SamplesPerPixel, image.PixelRepresentation = 24, 20, 1, 0
    image.PhotometricInterpretation = "MONOCHROME2"
    image.BitsAllocated, image.BitsStored, image.HighBit = 16, 16, 15
    image.PixelData = np.arange(24 * 20, dtype=np.uint16).tobytes()
    for name, uid in common.items():
        setattr(image, name, uid)
    image.save_as(series / f"{k}.dcm", enforce_file_format=True)

read = mrmeshpy.VoxelsLoad.loadDicomFolder(str(series), 2)
size, shift = read.vol.voxelSize, read.xf.b
seen = [[round(float(each), 5) for each in (vector.x, vector.y, vector.z)] for vector in (size, shift)]
print("voxels", seen[0], "shift", seen[1], "; in the files 1.5 x 1.5 x 4 mm and (120, -80, 300) mm")
sys.exit(seen != [[0.0015, 0.0015, 0.004], [120.0, -80.0, 300.0]])
PYTHON
