#!/bin/sh
# VTK 9.7.2 (pyvista 0.49.1) and SimpleITK 2.5.7: a valid DICOM series of six MR slices, pixels of 1.5 mm, 5 mm
# apart, the first at (-30, -80, 300) mm, with one bright voxel, read by each.
# Guess: the bright voxel is at one place in both, (-25.5, -77, 320) mm: VTK's images have an origin and a
#        direction matrix.
# Seen:  `pyvista.DICOMReader` counts rows from the last one and slices from the top, and says so nowhere: origin
#        0, no direction. The voxel is at (4.5, 40.5, 5); a segmentation laid on the image by voxels is turned
#        by 180 degrees about x, though size and spacing are right. No word is said.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyvista==0.49.1 vtk==9.7.2 SimpleITK==2.5.7 pydicom==3.0.1 numpy==2.4.6 \
  2>/dev/null
cd "$folder"
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import os
import sys

import numpy as np
import pydicom
import pyvista
import SimpleITK as sitk
from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid

os.mkdir("series")
study, series, frame = generate_uid(), generate_uid(), generate_uid()
for k in range(6):
    pixels = np.full((30, 40), 100, np.uint16)
    pixels[2, 3] = 900 if k == 4 else 100
    meta = pydicom.dataset.FileMetaDataset()
    meta.TransferSyntaxUID, meta.MediaStorageSOPClassUID = ExplicitVRLittleEndian, MRImageStorage
    data = pydicom.Dataset()
    data.file_meta = meta
    data.SOPClassUID, data.SOPInstanceUID = MRImageStorage, generate_uid()
    meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID
    data.StudyInstanceUID, data.SeriesInstanceUID, data.FrameOfReferenceUID = study, series, frame
    data.Modality, data.SeriesNumber, data.InstanceNumber = "MR", 1, k + 1
    data.ImagePositionPatient, data.ImageOrientationPatient = [-30, -80, 300 + 5 * k], [1, 0, 0, 0, 1, 0]
    data.PixelSpacing, data.SliceThickness, data.SpacingBetweenSlices = [1.5, 1.5], 5, 5
    data.Rows, data.Columns = pixels.shape
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 0
    data.PixelData = pixels.tobytes()
    data.save_as(f"series/{k}.dcm", enforce_file_format=True)
image = sitk.ReadImage(sitk.ImageSeriesReader.GetGDCMSeriesFileNames("series"))
at = np.argwhere(sitk.GetArrayFromImage(image) == 900)[0][::-1]
seen = {"SimpleITK": [round(each, 1) for each in image.TransformIndexToPhysicalPoint(at.tolist())]}
grid = pyvista.DICOMReader("series").read()
seen["VTK"] = [round(float(each), 1) for each in grid.points[np.argmax(grid.active_scalars)]]
print(seen, "spacing in VTK", grid.spacing)
sys.exit((seen, list(grid.spacing)) != ({"SimpleITK": [-25.5, -77.0, 320.0], "VTK": [4.5, 40.5, 5.0]},
                                        [1.5, 1.5, 5.0]))
PYTHON
