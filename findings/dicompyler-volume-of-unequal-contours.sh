#!/bin/sh
# dicompyler-core 0.5.6 and pydicom 2.4.4: the volume of a bone of 20 x 20 mm, 40 mm long, from its contours
# (RTSTRUCT): one every 2 mm, and one every 10 mm with two more near its end, as where outlines are drawn only
# where the shape changes. By `CalculatePlaneThickness` and `CalculateStructureVolume`.
# Guess: 16 cm3 of both.
# Seen:  16 and 4.8 cm3: the smallest distance of two contours is taken for all of them. No word is said; with
#        equal distances the volume is right.
# Exits non-zero if that changes.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q dicompyler-core==0.5.6 pydicom==2.4.4 shapely==2.1.2 numpy==1.26.4 2>/dev/null
"$folder/venv/bin/python" -W ignore - "$folder" <<'PYTHON'
import sys
from pathlib import Path

from dicompylercore import dicomparser
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

RT_STRUCTURE_SET = "1.2.840.10008.5.1.4.1.1.481.3"


def structures(path, heights):
    """An RTSTRUCT of one closed outline of 20 x 20 mm at each height, mm."""
    meta = FileMetaDataset()
    meta.TransferSyntaxUID, meta.MediaStorageSOPClassUID = ExplicitVRLittleEndian, RT_STRUCTURE_SET
    meta.MediaStorageSOPInstanceUID = generate_uid()
    data = FileDataset(str(path), {}, file_meta=meta, preamble=b"\0" * 128)
    data.is_little_endian, data.is_implicit_VR = True, False
    data.SOPClassUID, data.SOPInstanceUID = RT_STRUCTURE_SET, meta.MediaStorageSOPInstanceUID
    data.StudyInstanceUID, data.SeriesInstanceUID, frame = generate_uid(), generate_uid(), generate_uid()
    data.PatientName, data.PatientID, data.PatientBirthDate, data.PatientSex = "A", "1", "", ""
    data.StudyDate = data.StudyTime = data.StudyID = data.AccessionNumber = data.ReferringPhysicianName = ""
    data.Modality, data.Manufacturer, data.SeriesNumber = "RTSTRUCT", "", 1
    data.StructureSetLabel, data.StructureSetDate, data.StructureSetTime = "BONE", "", ""
    data.FrameOfReferenceUID = frame
    region, contours, observed = Dataset(), Dataset(), Dataset()
    region.ROINumber, region.ReferencedFrameOfReferenceUID = 1, frame
    region.ROIName, region.ROIGenerationAlgorithm = "bone", "MANUAL"
    contours.ReferencedROINumber, contours.ROIDisplayColor, contours.ContourSequence = 1, [255, 0, 0], []
    for height in heights:
        contour = Dataset()
        contour.ContourGeometricType, contour.NumberOfContourPoints = "CLOSED_PLANAR", 4
        contour.ContourData = [each for x, y in ((0, 0), (20, 0), (20, 20), (0, 20)) for each in (x, y, height)]
        contours.ContourSequence.append(contour)
    observed.ObservationNumber, observed.ReferencedROINumber = 1, 1
    observed.RTROIInterpretedType, observed.ROIInterpreter = "ORGAN", ""
    data.StructureSetROISequence, data.ROIContourSequence = [region], [contours]
    data.RTROIObservationsSequence = [observed]
    data.save_as(str(path), write_like_original=False)


seen = {}
for name, heights in {"every 2 mm": range(0, 42, 2), "every 10 mm and two more": (0, 10, 20, 30, 36, 38, 40)}.items():
    path = Path(sys.argv[1]) / "a.dcm"
    structures(path, heights)
    reader = dicomparser.DicomParser(str(path))
    planes = reader.GetStructureCoordinates(1)
    thickness = reader.CalculatePlaneThickness(planes)
    seen[name] = [float(thickness), round(reader.CalculateStructureVolume(planes, thickness), 1)]
    print(f"{name}: thickness {seen[name][0]} mm, volume {seen[name][1]} cm3")
sys.exit(seen != {"every 2 mm": [2.0, 16.0], "every 10 mm and two more": [2.0, 4.8]})
PYTHON
