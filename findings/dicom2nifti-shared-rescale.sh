#!/bin/sh
# dicom2nifti 2.6.2 and SimpleITK 2.5.7: two valid enhanced (multi-frame) MR images that say the same: stored
# values 500, rescale slope 0.01. In one the slope is given for each frame, in the other once for all (Shared
# Functional Groups, where what is common to all frames belongs).
# Guess: both files give 5 in every voxel.
# Seen:  dicom2nifti looks for the slope in the frames' own groups only: 5, and 500 where it is shared,
#        without a word. SimpleITK gives 5 for both.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q dicom2nifti==2.6.2 SimpleITK==2.5.7 pydicom==3.0.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import dicom2nifti
import nibabel as nib
import numpy as np
import SimpleITK as sitk
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import EnhancedMRImageStorage, ExplicitVRLittleEndian, generate_uid


def group(**tags):
    """A data set of these tags; those that are data sets become sequences of one item."""
    found = Dataset()
    for name, value in tags.items():
        setattr(found, name, [value] if isinstance(value, Dataset) else value)
    return found


def write(folder, *, shared):
    """A stack of six frames, 4 mm apart."""
    folder.mkdir()
    measures = group(PixelSpacing=[1, 1], SliceThickness=4, SpacingBetweenSlices=4)
    slope = group(RescaleSlope=0.01, RescaleIntercept=0, RescaleType="US")
    in_all = {"PixelValueTransformationSequence": slope} if shared else {}
    in_each = {} if shared else {"PixelValueTransformationSequence": slope}
    image = group(
        SOPClassUID=EnhancedMRImageStorage, SOPInstanceUID=generate_uid(), StudyInstanceUID=generate_uid(),
        SeriesInstanceUID=generate_uid(), FrameOfReferenceUID=generate_uid(), Modality="MR", PatientID="test",
        PatientName="test", SeriesNumber=1, InstanceNumber=1, ImageType=["ORIGINAL", "PRIMARY", "M", "NONE"],
        Rows=8, Columns=10, NumberOfFrames=6, BitsAllocated=16, BitsStored=16, HighBit=15,
        PixelRepresentation=0, SamplesPerPixel=1, PhotometricInterpretation="MONOCHROME2",
        SharedFunctionalGroupsSequence=group(
            PixelMeasuresSequence=measures,
            PlaneOrientationSequence=group(ImageOrientationPatient=[1, 0, 0, 0, 1, 0]), **in_all,
        ),
        PerFrameFunctionalGroupsSequence=[
            group(
                PlanePositionSequence=group(ImagePositionPatient=[0, 0, 4 * k]),
                FrameContentSequence=group(StackID="1", InStackPositionNumber=k + 1), **in_each,
            )
            for k in range(6)
        ],
        PixelData=np.full((6, 8, 10), 500, "<u2").tobytes(),
    )  # fmt: skip
    image.file_meta = FileMetaDataset()
    image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    image.save_as(folder / "a.dcm", enforce_file_format=True)
    return folder


seen = {}
for name in ("frames", "shared"):
    series = write(Path(sys.argv[1]) / name, shared=name == "shared")
    dicom2nifti.dicom_series_to_nifti(str(series), f"{series}.nii", reorient_nifti=False)
    by_dicom2nifti = np.unique(nib.load(f"{series}.nii").get_fdata().round(6)).tolist()
    by_itk = np.unique(sitk.GetArrayFromImage(sitk.ReadImage(str(series / "a.dcm"))).round(6)).tolist()
    seen[name] = by_dicom2nifti, by_itk
    print(f"slope of {name}: dicom2nifti {by_dicom2nifti}, SimpleITK {by_itk}")
sys.exit(seen != {"frames": ([5.0], [5.0]), "shared": ([500.0], [5.0])})
PYTHON
