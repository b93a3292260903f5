#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4) and dicom2nifti 2.6.2: a valid DICOM series of a map of shear-wave speed whose
# slices have rescale slopes of their own, as quantitative maps do: 2.75 m/s in all but the first, which has
# 3, slope 1.
# Guess: both return 3, then 2.75 in every slice.
# Seen:  SimpleITK takes the type of all voxels from the first slice, which has no fraction: 2 in every slice
#        but the first, without a word. dicom2nifti gives 2.75, and so does SimpleITK where the first slice is
#        left out.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 dicom2nifti==2.6.2 pydicom==3.0.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import dicom2nifti
import nibabel as nib
import numpy as np
import SimpleITK as sitk
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid

folder = Path(sys.argv[1])
(folder / "map").mkdir()
common = {each: generate_uid() for each in ("StudyInstanceUID", "SeriesInstanceUID", "FrameOfReferenceUID")}
paths = []
for k, (stored, slope) in enumerate([(3, 1.0), (275, 0.01), (550, 0.005), (1100, 0.0025)]):
    image = Dataset()
    image.file_meta = FileMetaDataset()
    image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    image.SOPClassUID, image.SOPInstanceUID = MRImageStorage, generate_uid()
    image.Modality, image.PatientID, image.PatientName = "MR", "test", "test"
    image.StudyDate, image.StudyTime, image.StudyID = "20200101", "000000", "1"
    image.SeriesNumber, image.InstanceNumber = 1, k + 1
    image.Rows, image.Columns, image.PixelSpacing, image.SliceThickness = 8, 10, [1, 1], 4
    image.ImageOrientationPatient, image.ImagePositionPatient = [1, 0, 0, 0, 1, 0], [0, 0, 4 * k]
    image.BitsAllocated, image.BitsStored, image.HighBit, image.PixelRepresentation = 16, 16, 15, 0
    image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
    image.RescaleSlope, image.RescaleIntercept = slope, 0
    image.PixelData = np.full((8, 10), stored, "<u2").tobytes()
    for name, uid in common.items():
        setattr(image, name, uid)
    paths.append(str(folder / "map" / f"{k}.dcm"))
    image.save_as(paths[-1], enforce_file_format=True)
by_itk = sitk.ReadImage(paths)
values = sitk.GetArrayFromImage(by_itk)[:, 4, 5].tolist()
without_first = sitk.GetArrayFromImage(sitk.ReadImage(paths[1:]))[:, 4, 5].round(6).tolist()
dicom2nifti.dicom_series_to_nifti(str(folder / "map"), str(folder / "a.nii"), reorient_nifti=False)
by_dicom2nifti = nib.load(folder / "a.nii").get_fdata()[5, 4].round(6).tolist()
print("SimpleITK:", values, by_itk.GetPixelIDTypeAsString())
print("SimpleITK without the first:", without_first)
print("dicom2nifti:", by_dicom2nifti)
speeds = [2.75, 2.75, 2.75]
sys.exit((values, without_first, by_dicom2nifti) != ([3, 2, 2, 2], speeds, [3.0, *speeds]))
PYTHON
