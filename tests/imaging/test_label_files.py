"""Label maps from NRRD, .seg.nrrd and DICOM SEG."""

from __future__ import annotations

import gzip

import nibabel as nib
import numpy as np
import pydicom
import pytest
from limb_images import Limb, dicom_seg, without_meta
from scipy.spatial.transform import Rotation

from limbcli.case.label_sources import LabelSource
from limbcli.errors import CaseError
from limbcli.imaging.label_files import read_label_file, read_label_map
from limbcli.imaging.label_names import meaning_of
from limbcli.imaging.labels import write_labels
from limbcli.imaging.nrrd import read_nrrd
from limbcli.imaging.volume import RAS_FROM_LPS, Volume


@pytest.fixture(scope="module")
def truth():
    turned = Rotation.from_euler("xyz", [4, -6, 9], degrees=True).as_matrix()
    image, labels = Limb(markers=((43.5, 0.0, -8.0),)).image(
        shape=(52, 46, 10), spacing=(2, 2, 4), rotation=turned, samples=1
    )
    return Volume(labels.astype(np.uint8), image.affine)


def nrrd(
    path, volume, *, encoding="gzip", space="left-posterior-superior", extra="", values=None, before=b"",
    inside=b"", layers_last=False,
):  # fmt: skip
    values = volume.values if values is None else values
    affine = RAS_FROM_LPS @ volume.affine if space.startswith("right") else volume.affine
    columns = [f"({','.join(f'{x:.9g}' for x in affine[:3, n])})" for n in range(3)]
    layers = ["none"] * (values.ndim - 3)
    columns = columns + layers if layers_last else layers + columns
    data = inside + values.tobytes(order="F")
    header = (
        f"NRRD0004\n# made for a test\ntype: unsigned char\ndimension: {values.ndim}\nspace: {space}\n"
        f"sizes: {' '.join(map(str, values.shape))}\nspace directions: {' '.join(columns)}\n"
        f"kinds: domain domain domain\nendian: little\nencoding: {encoding}\n"
        f"space origin: ({','.join(f'{x:.9g}' for x in affine[:3, 3])})\n{extra}\n"
    )
    path.write_bytes(header.encode() + before + (gzip.compress(data) if encoding == "gzip" else data))
    return path


def assert_same(found, truth):
    assert np.array_equal(found.values, truth.values)
    np.testing.assert_allclose(found.affine, truth.affine, atol=1e-5)


@pytest.mark.parametrize("encoding", ["raw", "gzip"])
@pytest.mark.parametrize("space", ["left-posterior-superior", "right-anterior-superior"])
def test_a_nrrd_label_map_is_read_in_place(truth, tmp_path, encoding, space):
    path = nrrd(tmp_path / "labels.nrrd", truth, encoding=encoding, space=space)
    assert_same(read_label_file(path), truth)


@pytest.mark.parametrize(
    ("encoding", "extra", "before", "inside"),
    [("raw", "byte skip: 7\n", b"", b"1234567"), ("raw", "byte skip: -1\n", b"any\nthing", b""),
     ("raw", "line skip: 2\n", b"one\ntwo\n", b""), ("raw", "line skip: 1\nbyte skip: 3\n", b"one\n", b"123"),
     ("gzip", "byte skip: 5\n", b"", b"12345"), ("gzip", "line skip: 1\n", b"one\n", b"")],
)  # fmt: skip
def test_what_is_to_be_skipped_is_no_data(truth, tmp_path, encoding, extra, before, inside):
    path = nrrd(tmp_path / "a.nrrd", truth, encoding=encoding, extra=extra, before=before, inside=inside)
    assert_same(read_label_file(path), truth)


@pytest.mark.parametrize("extra", ["byte skip: -2\n", "line skip: 9999\n", "byte skip: x\n"])
def test_what_cannot_be_skipped_is_refused(truth, tmp_path, extra):
    with pytest.raises(CaseError, match="cannot be read"):
        read_label_file(nrrd(tmp_path / "a.nrrd", truth, encoding="raw", extra=extra))


def test_layers_are_found_wherever_their_axis_is(truth, tmp_path):
    bone = np.where(truth.values == 2, 1, 0).astype(np.uint8)
    marker = np.where(truth.values == 3, 1, 0).astype(np.uint8)
    first = read_nrrd(nrrd(tmp_path / "a.nrrd", truth, values=np.stack([bone, marker])))
    last = read_nrrd(
        nrrd(tmp_path / "b.nrrd", truth, values=np.stack([bone, marker], axis=-1), layers_last=True)
    )
    assert np.array_equal(first.values[0], bone)
    assert np.array_equal(first.values, last.values)
    np.testing.assert_allclose(first.affine, last.affine)


def test_a_seg_nrrd_is_brought_to_our_labels_by_its_names(truth, tmp_path):
    """Two layers that overlap: everything in the skin, and the bone inside it with another number."""
    skin = np.where(np.isin(truth.values, (1, 2)), 1, np.where(truth.values == 3, 5, 0))
    bone = np.where(truth.values == 2, 9, 0)
    extra = (
        "Segment0_Name:=Skin\nSegment0_LabelValue:=1\nSegment0_Layer:=0\n"
        "Segment1_Name:=Tibia and fibula\nSegment1_LabelValue:=9\nSegment1_Layer:=1\n"
        "Segment2_Name:=Marker capsules\nSegment2_LabelValue:=5\nSegment2_Layer:=0\n"
    )
    layers = np.stack([skin, bone]).astype(np.uint8)
    path = nrrd(tmp_path / "s.seg.nrrd", truth, extra=extra, values=layers)
    assert_same(read_label_file(path), truth)


def test_a_seg_nrrd_of_an_older_slicer_has_a_layer_for_each_segment(truth, tmp_path):
    """Neither layer nor value is stated: segment n is layer n, where it is 1."""
    extra = "".join(
        f"Segment{n}_ID:=Segment_{n}\nSegment{n}_Name:={name}\n"
        for n, name in enumerate(("Skin", "Bone", "Marker"))
    )
    layers = np.stack([truth.values > 0, truth.values == 2, truth.values == 3]).astype(np.uint8)
    assert_same(read_label_file(nrrd(tmp_path / "s.seg.nrrd", truth, extra=extra, values=layers)), truth)


@pytest.mark.parametrize("entry", ["Segment0_Layer:=7", "Segment0_Layer:=x", "Segment0_LabelValue:=y"])
def test_a_seg_nrrd_with_an_impossible_description_is_refused(truth, tmp_path, entry):
    path = nrrd(tmp_path / "s.seg.nrrd", truth, extra=f"Segment0_Name:=Skin\n{entry}\n")
    with pytest.raises(CaseError, match=r"segment 0"):
        read_label_file(path)


def test_a_value_that_a_seg_nrrd_does_not_describe_is_refused(truth, tmp_path):
    extra = "Segment0_Name:=Skin\nSegment0_LabelValue:=1\nSegment1_Name:=Marker\nSegment1_LabelValue:=3\n"
    with pytest.raises(CaseError, match="2") as caught:
        read_label_file(nrrd(tmp_path / "s.seg.nrrd", truth, extra=extra))
    assert caught.value.facts["unknown"] == ["2"]


def test_segments_without_telling_names_are_refused(truth, tmp_path):
    extra = "Segment0_Name:=Segment_1\nSegment0_LabelValue:=1\n"
    with pytest.raises(CaseError, match="Segment_1"):
        read_label_file(nrrd(tmp_path / "s.seg.nrrd", truth, extra=extra))


@pytest.mark.parametrize("text", [b"no nrrd", b"NRRD0004\ntype: block\nsizes: 2\n\nx"])
def test_a_broken_nrrd_is_refused(tmp_path, text):
    (tmp_path / "a.nrrd").write_bytes(text)
    with pytest.raises(CaseError, match="label map"):
        read_label_file(tmp_path / "a.nrrd")


def test_a_nrrd_label_map_that_does_not_say_how_it_lies_or_in_what_unit_is_refused(truth, tmp_path):
    path = nrrd(tmp_path / "a.nrrd", truth)
    content = path.read_bytes()
    path.write_bytes(content.replace(b"space: left-posterior-superior", b"space dimension: 3"))
    with pytest.raises(CaseError, match="the label map does not define its orientation"):
        read_label_file(path)
    in_cm = nrrd(tmp_path / "b.nrrd", truth, extra='space units: "cm" "cm" "cm"\n')
    with pytest.raises(CaseError, match="the label map's unit of length is cm"):
        read_label_file(in_cm)


def test_a_dicom_seg_is_brought_to_our_labels_by_its_names(truth, tmp_path):
    path = dicom_seg(tmp_path / "seg.dcm", truth, {"Soft tissue": 1, "Bone": 2, "Marker": 3})
    found = read_label_file(path)
    whole = np.flatnonzero((truth.values > 0).any(axis=(0, 1)))
    assert np.array_equal(found.values, truth.values[:, :, whole[0] : whole[-1] + 1])
    np.testing.assert_allclose(found.affine[:3, :3], truth.affine[:3, :3], atol=1e-5)


def label_map_seg(path, truth, names):
    """As highdicom 0.28 writes it: the pixel is the number; frames have no segment; 0 is described."""
    dicom_seg(path, truth.with_values(np.ones_like(truth.values)), {"any": 1})
    dataset = pydicom.dcmread(path)
    dataset.SOPClassUID = dataset.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.66.7"
    dataset.SegmentationType, dataset.BitsAllocated, dataset.BitsStored, dataset.HighBit = "LABELMAP", 8, 8, 7
    dataset.add_new("PixelPaddingValue", "US", 0)
    for frame in dataset.PerFrameFunctionalGroupsSequence:
        del frame.SegmentIdentificationSequence
    segments = []
    for number, name in {0: "Background", **names}.items():
        segment = pydicom.Dataset()
        segment.SegmentNumber, segment.SegmentLabel = number, name
        segments.append(segment)
    dataset.SegmentSequence = segments
    planes = np.ascontiguousarray(np.moveaxis(truth.values, 2, 0).transpose(0, 2, 1)).astype(np.uint8)
    dataset.PixelData = planes.tobytes()
    dataset.save_as(path)
    return path


def test_a_dicom_label_map_is_brought_to_our_labels_by_its_names(truth, tmp_path):
    values = np.select([truth.values == n for n in (1, 2, 3)], [5, 2, 9]).astype(np.uint8)
    names = {5: "Soft tissue", 2: "Tibia", 9: "Marker", 7: "Fibula"}
    path = label_map_seg(tmp_path / "seg.dcm", truth.with_values(values), names)
    assert_same(read_label_file(path), truth)


def test_a_number_of_a_dicom_label_map_that_is_not_described_is_refused(truth, tmp_path):
    path = label_map_seg(tmp_path / "seg.dcm", truth, {1: "Soft tissue", 2: "Tibia"})
    with pytest.raises(CaseError, match=r"value\(s\) 3") as caught:
        read_label_file(path)
    assert '3 = "ignore"' in caught.value.fix


def test_a_dicom_seg_without_preamble_and_file_meta_is_read(truth, tmp_path):
    path = dicom_seg(tmp_path / "seg.dcm", truth, {"Soft tissue": 1, "Bone": 2})
    whole = read_label_file(path)
    without_meta(path)
    assert_same(read_label_file(path), whole)


def test_slices_that_slide_along_with_a_gantrys_tilt_keep_their_places(truth, tmp_path):
    tilted = truth.affine.copy()
    tilted[:3, 2] += 0.4 * tilted[:3, 1]
    tilted = Volume(truth.values, tilted)
    found = read_label_file(dicom_seg(tmp_path / "seg.dcm", tilted, {"Soft tissue": 1, "Bone": 2}))
    bone, true = (each.to_patient(np.argwhere(each.values == 2).astype(float)) for each in (found, tilted))
    np.testing.assert_allclose(bone, true, atol=1e-4)
    write_labels(tmp_path / "labels.nii.gz", found)
    np.testing.assert_allclose(read_label_file(tmp_path / "labels.nii.gz").affine, found.affine, atol=1e-4)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_slice_beside_the_line_of_the_others_is_refused(truth, tmp_path, axis):
    path = dicom_seg(tmp_path / "seg.dcm", truth, {"Soft tissue": 1})
    dataset = pydicom.dcmread(path)
    group = dataset.PerFrameFunctionalGroupsSequence[4].PlanePositionSequence[0]
    place = np.array(group.ImagePositionPatient, float) + 1.5 * truth.affine[:3, axis]
    group.ImagePositionPatient = [f"{each:.10g}" for each in place]
    dataset.save_as(path)
    with pytest.raises(CaseError, match="do not lie on one line"):
        read_label_file(path)


def test_segments_a_hairs_breadth_apart_are_on_one_grid(truth, tmp_path):
    """Two segments whose planes differ by rounding: not one slice each 0.2 um."""
    path = dicom_seg(tmp_path / "seg.dcm", truth, {"Soft tissue": 1, "Bone": 2, "Marker": 3})
    dataset = pydicom.dcmread(path)
    for frame in dataset.PerFrameFunctionalGroupsSequence:
        if frame.SegmentIdentificationSequence[0].ReferencedSegmentNumber == 2:
            place = frame.PlanePositionSequence[0].ImagePositionPatient
            place[2] = f"{float(place[2]) + 0.0006:.10g}"
    dataset.save_as(path)
    found = read_label_file(path)
    whole = np.flatnonzero((truth.values > 0).any(axis=(0, 1)))
    assert np.array_equal(found.values, truth.values[:, :, whole[0] : whole[-1] + 1])
    np.testing.assert_allclose(found.affine[:3, :3], truth.affine[:3, :3], atol=1e-3)


def test_slices_that_are_not_evenly_spaced_are_refused(truth, tmp_path):
    path = dicom_seg(tmp_path / "seg.dcm", truth, {"Soft tissue": 1})
    dataset = pydicom.dcmread(path)
    place = dataset.PerFrameFunctionalGroupsSequence[-1].PlanePositionSequence[0].ImagePositionPatient
    place[2] = f"{float(place[2]) + 0.4 * truth.spacing[2]:.10g}"
    dataset.save_as(path)
    with pytest.raises(CaseError, match="not evenly spaced"):
        read_label_file(path)


def test_an_image_is_no_dicom_seg(truth, tmp_path):
    path = dicom_seg(tmp_path / "seg.dcm", truth, {"Soft tissue": 1, "Bone": 2})
    dataset = pydicom.dcmread(path)
    dataset.Modality = "MR"
    dataset.save_as(path)
    with pytest.raises(CaseError, match=r"0008,0060(.|\n)*imaging. mri"):
        read_label_file(path)


@pytest.mark.parametrize("name", ["IM000001", "1.2.826.0.1.7"])
def test_a_dicom_seg_needs_no_ending(truth, tmp_path, name):
    (tmp_path / "seg").mkdir()
    path = dicom_seg(tmp_path / "seg" / name, truth, {"Soft tissue": 1, "Bone": 2, "Marker": 3})
    assert_same(read_label_file(path), truth)
    assert_same(read_label_file(path.parent), truth)


def test_other_formats_are_refused_with_those_that_are_read(truth, tmp_path):
    path = tmp_path / "a.img"
    nib.save(nib.AnalyzeImage(truth.values.astype(np.int16), np.diag([2.0, 2.0, 4.0, 1.0])), path)
    with pytest.raises(CaseError, match=r"not in a format(.|\n)*\.nii\.gz(.|\n)*the \.hdr"):
        read_label_file(path)
    with pytest.raises(CaseError, match=r"label map does not define its orientation(.|\n)*Analyze 7\.5"):
        read_label_file(tmp_path / "a.hdr")


@pytest.mark.parametrize("name", ["a.mgh", "a.mgz", "a.hdr"])
def test_a_label_map_of_freesurfer_or_in_a_pair_is_read(truth, tmp_path, name):
    kind = nib.Nifti1Pair if name == "a.hdr" else nib.MGHImage
    made = kind(truth.values, RAS_FROM_LPS @ truth.affine)
    nib.save(made, tmp_path / name)
    assert_same(read_label_file(tmp_path / name), truth)


def test_segments_of_one_value_in_several_layers_are_told_apart_by_name(truth, tmp_path):
    layers = np.stack([truth.values > 0, truth.values == 2]).astype(np.uint8)
    extra = "".join(f"Segment{k}_Name:=Segment_{k}\nSegment{k}_LabelValue:=1\nSegment{k}_Layer:={k}\n"
                    for k in (0, 1))  # fmt: skip
    path = nrrd(tmp_path / "a.seg.nrrd", truth, values=layers, extra=extra)
    with pytest.raises(CaseError, match='"Segment_0" = "ignore", "Segment_1" = "ignore"'):
        read_label_file(path)
    source = LabelSource(path, names={"Segment_0": "soft tissue", "Segment_1": "bone"})
    assert (read_label_map([source]).volume.values == 2).sum() == (truth.values == 2).sum()


NAMES = {
    "Tibialis anterior": 1, "Fibularis longus muscle": 1, "Musculus tibialis posterior": 1,
    "soft tissue without bone": 1, "Muscle (between tibia and fibula)": 1, "rectus femoris": 1,
    "patellar tendon": 1, "Skin": 1, "left leg": 1, "limb soft tissue": 1,
    "Tibia": 2, "TIBIA_1": 2, "tibiaLeft": 2, "CorticalBone": 2, "bone tissue": 2, "Bones of the leg": 2,
    "subcutaneous fat": 4, "intermuscular adipose tissue": 4, "skin marker 2": 3, "Tibia marker": 3,
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_whole_words_of_a_name_tell_what_a_segment_is(name):
    assert meaning_of(name).label == NAMES[name]


@pytest.mark.parametrize("name", ["tibialish", "non-bone", "bone and fat", "skin and bone", "muscle fat"])
def test_a_name_of_several_kinds_or_none_is_not_understood(name):
    assert meaning_of(name) is None
