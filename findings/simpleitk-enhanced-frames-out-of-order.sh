#!/bin/sh
# SimpleITK 2.5.7 (ITK 5.4) and highdicom 0.28.2: a valid enhanced (multi-frame) MR image whose six frames, 4
# mm apart, are stored as they were acquired: 0, 8, 16, then 4, 12, 20 mm. Each frame states its position.
# Guess: both return the slices in order of position, with a distance of 4 mm.
# Seen:  SimpleITK returns them as stored and a distance of 1 mm, although Spacing Between Slices says 4:
#        slices of the limb change places, and it is four times too short. No word is said. highdicom sorts
#        them.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q SimpleITK==2.5.7 highdicom==0.28.2 pydicom==3.0.2 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder/a.dcm" <<'PYTHON'
import sys

import highdicom as hd
import numpy as np
import SimpleITK as sitk
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import EnhancedMRImageStorage, ExplicitVRLittleEndian, generate_uid

PLACES = [0, 8, 16, 4, 12, 20]


def item(**tags):
    """A sequence of one item."""
    found = Dataset()
    for name, value in tags.items():
        setattr(found, name, value)
    return [found]


image = Dataset()
image.file_meta = FileMetaDataset()
image.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
image.SOPClassUID, image.SOPInstanceUID, organization = EnhancedMRImageStorage, generate_uid(), generate_uid()
image.StudyInstanceUID, image.SeriesInstanceUID, image.FrameOfReferenceUID = (generate_uid() for _ in "abc")
image.Modality, image.PatientID, image.PatientName = "MR", "test", "test"
image.SeriesNumber = image.InstanceNumber = 1
image.ImageType = ["ORIGINAL", "PRIMARY", "M", "NONE"]
image.Rows, image.Columns, image.NumberOfFrames = 8, 10, len(PLACES)
image.BitsAllocated, image.BitsStored, image.HighBit, image.PixelRepresentation = 16, 16, 15, 0
image.SamplesPerPixel, image.PhotometricInterpretation = 1, "MONOCHROME2"
image.DimensionOrganizationSequence = item(DimensionOrganizationUID=organization)
image.DimensionIndexSequence = item(
    DimensionIndexPointer=0x00209057, FunctionalGroupPointer=0x00209111, DimensionOrganizationUID=organization
)
image.SharedFunctionalGroupsSequence = item(
    PixelMeasuresSequence=item(PixelSpacing=[1, 1], SliceThickness=4, SpacingBetweenSlices=4),
    PlaneOrientationSequence=item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0]),
)
image.PerFrameFunctionalGroupsSequence = [
    item(
        PlanePositionSequence=item(ImagePositionPatient=[0, 0, z]),
        FrameContentSequence=item(
            StackID="1", InStackPositionNumber=z // 4 + 1, DimensionIndexValues=[z // 4 + 1]
        ),
    )[0]
    for z in PLACES
]
# the value of each voxel is its position
image.PixelData = np.stack([np.full((8, 10), z, "<u2") for z in PLACES]).tobytes()
image.save_as(sys.argv[1], enforce_file_format=True)
found = sitk.ReadImage(sys.argv[1])
by_itk = sitk.GetArrayFromImage(found)[:, 4, 5].tolist()
volume = hd.imread(sys.argv[1]).get_volume()
by_highdicom = volume.array[:, 4, 5].astype(int).tolist()
print("SimpleITK: slices of", by_itk, "at", found.GetSpacing()[2], "mm")
print("highdicom: slices of", by_highdicom, "at", volume.spacing[0], "mm")
same = sorted(PLACES) in (by_highdicom, by_highdicom[::-1]) and volume.spacing[0] == 4
sys.exit(not (same and by_itk == PLACES and found.GetSpacing()[2] == 1))
PYTHON
