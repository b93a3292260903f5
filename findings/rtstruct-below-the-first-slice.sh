#!/bin/sh
# dcmrtstruct2nii 5 and pydicomrt 0.9.1: contours (RTSTRUCT) of a bone in ten slices, 0 to 36 mm, on the MR series
# that they were drawn on (0 to 76 mm), and on one that begins at 20 mm, as where the images were cropped or the
# first ones not copied.
# Guess: the contours below the first slice are left out, or a word is said: slices 0 to 4 of the shorter series;
#        dcmrtstruct2nii has a message for contours that are out of bounds.
# Seen:  the bone is in the last slices, too, 56 to 76 mm: the number of a slice below the first is negative,
#        and counts from the other end. Above the last slice both fail or tell it. pydicomrt also loses slice 0,
#        as it takes two contours there for a hole. No word is said; the volume is that of the whole bone.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
python3 -m venv "$folder/other"
"$folder/venv/bin/pip" install -q dcmrtstruct2nii==5 pydicom==2.4.4 numpy==1.26.4 SimpleITK==2.5.7 \
    scikit-image==0.26.0 2>/dev/null
"$folder/other/bin/pip" install -q pydicomrt==0.9.1 pydicom==3.0.2 numpy==2.4.6 2>/dev/null
cat >"$folder/data.py" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, MRImageStorage, generate_uid

folder, GAP, SLICES, DRAWN, FIRST = Path(sys.argv[1]), 4, 20, 10, 5
STUDY, SERIES, FRAME = generate_uid(), generate_uid(), generate_uid()
RT_STRUCTURE_SET = "1.2.840.10008.5.1.4.1.1.481.3"


def new(kind, modality):
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.is_little_endian, data.is_implicit_VR = True, False
    data.SOPClassUID, data.SOPInstanceUID, data.Modality = kind, generate_uid(), modality
    data.PatientID = data.PatientName = "a"
    data.PatientBirthDate = data.PatientSex = data.StudyDate = data.StudyTime = data.StudyID = ""
    data.StudyInstanceUID, data.FrameOfReferenceUID = STUDY, FRAME
    return data


images = []
for k in range(SLICES):
    image = new(MRImageStorage, "MR")
    image.SeriesInstanceUID, image.InstanceNumber = SERIES, k + 1
    image.ImageOrientationPatient, image.ImagePositionPatient = [1, 0, 0, 0, 1, 0], [0, 0, GAP * k]
    image.PixelSpacing, image.SliceThickness = [1, 1], GAP
    image.Rows, image.Columns, image.SamplesPerPixel, image.PixelRepresentation = 40, 60, 1, 0
    image.PhotometricInterpretation, image.PixelData = "MONOCHROME2", np.zeros((40, 60), np.uint16).tobytes()
    image.BitsAllocated, image.BitsStored, image.HighBit = 16, 16, 15
    images.append(image)
for name, part in (("whole", images), ("cropped", images[FIRST:])):
    (folder / name).mkdir()
    for image in part:
        image.save_as(folder / name / f"{image.InstanceNumber:02d}.dcm", write_like_original=False)

structures = new(RT_STRUCTURE_SET, "RTSTRUCT")
structures.SeriesInstanceUID = generate_uid()
structures.StructureSetLabel, structures.StructureSetDate, structures.StructureSetTime = "A", "", ""
region, drawn = Dataset(), Dataset()
region.ROINumber, region.ROIName, region.ROIGenerationAlgorithm = 1, "bone", "MANUAL"
region.ReferencedFrameOfReferenceUID = FRAME
drawn.ReferencedROINumber, drawn.ROIDisplayColor, drawn.ContourSequence = 1, [255, 0, 0], []
for k in range(DRAWN):
    contour, source = Dataset(), Dataset()
    source.ReferencedSOPClassUID, source.ReferencedSOPInstanceUID = MRImageStorage, images[k].SOPInstanceUID
    contour.ContourImageSequence, contour.ContourGeometricType = [source], "CLOSED_PLANAR"
    contour.NumberOfContourPoints = 4
    contour.ContourData = [v for x, y in ((20, 10), (40, 10), (40, 20), (20, 20)) for v in (x, y, GAP * k)]
    drawn.ContourSequence.append(contour)
structures.StructureSetROISequence, structures.ROIContourSequence = [region], [drawn]
structures.save_as(folder / "bone.dcm", write_like_original=False)
PYTHON
"$folder/venv/bin/python" -W ignore "$folder/data.py" "$folder"
first=0
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON' || first=$?
import contextlib
import io
import sys

import SimpleITK as sitk
from dcmrtstruct2nii import dcmrtstruct2nii

folder, seen = sys.argv[1], {}
for name in ("whole", "cropped"):
    with contextlib.redirect_stdout(io.StringIO()):
        dcmrtstruct2nii(f"{folder}/bone.dcm", f"{folder}/{name}", f"{folder}/{name}-masks")
    mask = sitk.GetArrayFromImage(sitk.ReadImage(f"{folder}/{name}-masks/mask_bone.nii.gz"))
    seen[name] = [k for k, each in enumerate(mask) if each.any()]
    print("dcmrtstruct2nii,", name, "series of", len(mask), "slices: bone in", *seen[name])
sys.exit(seen != {"whole": list(range(10)), "cropped": [0, 1, 2, 3, 4, 10, 11, 12, 13, 14]})
PYTHON
second=0
"$folder/other/bin/python" -W ignore - "$folder" <<'PYTHON' || second=$?
import sys
from pathlib import Path

import pydicom
from pydicomrt.rs.rs_to_volume import calc_image_series_affine_mapping, rtstruct_to_masks

folder, seen = Path(sys.argv[1]), {}
structures = pydicom.dcmread(folder / "bone.dcm")
for name in ("whole", "cropped"):
    series = [pydicom.dcmread(path) for path in sorted((folder / name).glob("*.dcm"))]
    mask = rtstruct_to_masks(structures, *calc_image_series_affine_mapping(series))["bone"]["mask_volume"]
    seen[name] = [k for k, each in enumerate(mask) if each.any()]
    print("pydicomrt,", name, "series of", len(mask), "slices: bone in", *seen[name])
sys.exit(seen != {"whole": list(range(10)), "cropped": [1, 2, 3, 4, 11, 12, 13, 14]})
PYTHON
exit $((first + second))
