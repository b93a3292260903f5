"""Contours of RT Structure Sets as label maps: bodies of known size and place."""

from __future__ import annotations

import numpy as np
import pydicom
import pytest
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, RTStructureSetStorage, generate_uid
from scipy.spatial.transform import Rotation

from limbcli.errors import CaseError
from limbcli.imaging.label_files import read_label_file
from limbcli.imaging.segmentation import BONE, SOFT_TISSUE

STEP, N, MIDDLE = 3.0, 21, np.array([-70.0, 25.0, -300.0])


def circle(radius: float, k: int, beside: float = 0.0) -> NDArray:
    """Points (n, 3), mm, of a circle in slice k about a middle that lies `beside` that of the limb."""
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    points = np.stack(
        [radius * np.cos(angle) + beside, radius * np.sin(angle), np.full(200, STEP * k)], axis=1
    )
    return np.asarray(points + MIDDLE)


def limb() -> dict[str, list[NDArray]]:
    """Skin of 40 mm radius with a tibia of 10 mm and its medullary canal of 4 mm, 10 mm beside the middle."""
    tibia = [circle(radius, k, 10.0) for k in range(3, N) for radius in (10.0, 4.0)]
    return {"Skin": [circle(40.0, k) for k in range(N)], "Tibia": tibia}


def rtstruct(path, structures: dict[str, list[NDArray]], kind: str = "CLOSED_PLANAR"):
    dataset = Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.file_meta.MediaStorageSOPClassUID = dataset.SOPClassUID = RTStructureSetStorage
    dataset.file_meta.MediaStorageSOPInstanceUID = dataset.SOPInstanceUID = generate_uid()
    dataset.Modality = "RTSTRUCT"
    dataset.StructureSetROISequence, dataset.ROIContourSequence = [], []
    for number, (name, contours) in enumerate(structures.items(), 1):
        roi, drawn = Dataset(), Dataset()
        roi.ROINumber, roi.ROIName, drawn.ReferencedROINumber = number, name, number
        drawn.ContourSequence = []
        for points in contours:
            contour = Dataset()
            contour.ContourGeometricType, contour.NumberOfContourPoints = kind, len(points)
            contour.ContourData = [f"{each:.5f}" for each in points.ravel()]
            drawn.ContourSequence.append(contour)
        dataset.StructureSetROISequence.append(roi)
        dataset.ROIContourSequence.append(drawn)
    dataset.save_as(path, enforce_file_format=True)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.0, 20.0])
def test_contours_become_bodies_of_their_size_and_place(tmp_path, turn):
    """A scan whose slices are tilted, too; canal and all: pi (40^2 - 10^2 + 4^2) and pi (10^2 - 4^2) mm2."""
    rotation = Rotation.from_euler("x", turn, degrees=True)
    turned = {name: [rotation.apply(each) for each in contours] for name, contours in limb().items()}
    found = read_label_file(rtstruct(tmp_path / "rs.dcm", turned))
    bone, soft = found.values == BONE, found.values == SOFT_TISSUE
    assert bone.sum() * found.voxel_volume == pytest.approx(np.pi * (100 - 16) * 18 * STEP, rel=0.01)
    assert (bone | soft).sum() * found.voxel_volume == pytest.approx(np.pi * 1600 * N * STEP, rel=0.005)
    middle = rotation.inv().apply(found.to_patient(np.argwhere(bone | soft)).mean(axis=0))
    np.testing.assert_allclose(middle, MIDDLE + np.array([0, 0, STEP * (N - 1) / 2]), atol=0.05)
    beside = rotation.inv().apply(found.to_patient(np.argwhere(bone)).mean(axis=0)) - MIDDLE
    np.testing.assert_allclose(beside, [10, 0, STEP * (3 + N - 1) / 2], atol=0.05)
    assert np.linalg.det(found.affine[:3, :3]) > 0


@pytest.mark.slow
def test_an_outline_is_known_by_its_type(tmp_path):
    contours = limb()
    dataset = pydicom.dcmread(
        rtstruct(tmp_path / "rs.dcm", {"External": contours["Skin"], "Tibia": contours["Tibia"]})
    )
    with pytest.raises(CaseError, match="External"):
        read_label_file(tmp_path / "rs.dcm")
    told = Dataset()
    told.ReferencedROINumber, told.RTROIInterpretedType = 1, "EXTERNAL"
    dataset.RTROIObservationsSequence = [told]
    dataset.save_as(tmp_path / "rs.dcm")
    assert (read_label_file(tmp_path / "rs.dcm").values == SOFT_TISSUE).any()


def test_points_and_open_contours_are_no_bodies(tmp_path):
    with pytest.raises(CaseError, match="no closed contours"):
        read_label_file(rtstruct(tmp_path / "rs.dcm", limb(), "OPEN_PLANAR"))


def test_a_structure_with_slices_without_contour_is_refused(tmp_path):
    every_second = limb() | {"Tibia": [circle(10.0, k, 10.0) for k in range(3, N, 2)]}
    with pytest.raises(CaseError, match=r"Tibia on 8(.|\n)*interpolate"):
        read_label_file(rtstruct(tmp_path / "rs.dcm", every_second))


def test_two_bodies_of_a_structure_that_lie_apart_are_no_gap(tmp_path):
    apart = [circle(6.0, k, -20.0) for k in range(8)] + [circle(6.0, k, 20.0) for k in range(12, N)]
    found = read_label_file(rtstruct(tmp_path / "rs.dcm", {"Skin": limb()["Skin"], "Bones": apart}))
    n_slices = (found.values == BONE).any(axis=(0, 1)).sum()
    assert n_slices == 17


@pytest.mark.parametrize(
    ("contours", "words"),
    [
        ([circle(40.0, 0), circle(30.0, 0)], "all contours lie in one slice"),
        ([circle(40.0, 0), circle(40.0, 1), circle(40.0, 2) + np.array([0, 0, 1.0])], "not evenly spaced"),
        ([circle(40.0, 0), Rotation.from_euler("x", 20, degrees=True).apply(circle(40.0, 1))], "parallel"),
    ],
)
def test_contours_that_are_no_series_of_slices_are_refused(tmp_path, contours, words):
    with pytest.raises(CaseError, match=words):
        read_label_file(rtstruct(tmp_path / "rs.dcm", {"Skin": contours, "Tibia": contours}))


def test_a_structure_set_without_its_names_is_damaged(tmp_path):
    dataset = pydicom.dcmread(rtstruct(tmp_path / "rs.dcm", limb()))
    del dataset.StructureSetROISequence
    dataset.save_as(tmp_path / "rs.dcm")
    with pytest.raises(CaseError, match="RTSTRUCT cannot be read"):
        read_label_file(tmp_path / "rs.dcm")
