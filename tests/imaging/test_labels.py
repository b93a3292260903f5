"""Label maps to and from NIfTI."""

from __future__ import annotations

import nibabel as nib
import numpy as np
import pytest
from limb_images import Limb
from scipy.spatial.transform import Rotation

from limbcli.errors import CaseError
from limbcli.imaging.labels import checked_labels, segmentation_from, write_labels
from limbcli.imaging.nifti import read_nifti_labels
from limbcli.imaging.volume import Volume

MARKERS = ((43.5, 0.0, -8.0), (0.0, 38.0, 12.0))


@pytest.fixture(scope="module")
def truth():
    image, labels = Limb(markers=MARKERS).image(
        rotation=Rotation.from_euler("xyz", [4, -6, 9], degrees=True).as_matrix(), samples=1
    )
    return image.with_values(labels.astype(np.uint8))


def test_the_file_places_voxels_in_ras_as_3d_slicer_expects(truth, tmp_path):
    write_labels(tmp_path / "labels.nii.gz", truth)
    image = nib.load(tmp_path / "labels.nii.gz")
    lps = truth.to_patient(np.array([[3.0, 5.0, 7.0]]))[0]
    np.testing.assert_allclose(image.affine @ [3, 5, 7, 1], [-lps[0], -lps[1], lps[2], 1], atol=1e-4)
    assert image.get_data_dtype() == np.uint8
    assert int(image.header["sform_code"]) == 1
    np.testing.assert_allclose(image.get_sform(), image.get_qform(), atol=1e-4)


def test_a_label_map_that_does_not_say_how_it_lies_is_refused(truth, tmp_path):
    """Its readers would take either side for the left."""
    nib.save(nib.Nifti1Image(truth.values, None), tmp_path / "labels.nii.gz")
    with pytest.raises(CaseError, match="does not define its orientation"):
        read_nifti_labels(tmp_path / "labels.nii.gz")


def test_a_stray_voxel_is_no_marker_and_no_bone_and_that_is_told(truth):
    """Markers are numbered from distal: a speck would take the number of the site's own."""
    values = truth.values.copy()
    limb = np.argwhere(values == 1)
    low = limb[np.argmin(truth.to_patient(limb)[:, 2])]
    values[tuple(low)] = 3
    values[tuple(low + [3, 3, 0] * np.sign(np.array(values.shape) // 2 - low))] = 2
    before, after = (segmentation_from(truth.with_values(each)) for each in (truth.values, values))
    assert [each.position for each in after.markers] == [each.position for each in before.markers]
    assert len(after.bones) == len(before.bones)
    assert before.notes == ()
    assert "1 speck of marker" in after.notes[1]
    assert "1 speck of bone" in after.notes[0]


def test_a_label_map_comes_back_as_written(truth, tmp_path):
    write_labels(tmp_path / "labels.nii.gz", truth)
    again, _ = read_nifti_labels(tmp_path / "labels.nii.gz")
    assert np.array_equal(again.values, truth.values)
    np.testing.assert_allclose(again.affine, truth.affine, atol=1e-4)


def test_skin_bones_and_markers_are_taken_from_labels(truth):
    found = segmentation_from(truth)
    assert len(found.bones) == 2
    assert found.bones[0].values.sum() > found.bones[1].values.sum()
    assert (found.skin.values & (truth.values == 2)).sum() == (truth.values == 2).sum()
    assert [each.number for each in found.markers] == [1, 2]
    np.testing.assert_allclose([each.position for each in found.markers], MARKERS, atol=1.5)


@pytest.mark.parametrize("side", ["left", "right"])
def test_of_two_limbs_in_a_label_map_the_one_meant_is_taken(truth, side):
    """Bones and markers of the other one are not this limb's."""
    limb = truth.values[::2, ::2]
    two = Volume(np.concatenate([limb, limb]), truth.affine @ np.diag([2.0, 2.0, 1.0, 1.0]))
    found = segmentation_from(two, side=side)
    empty = np.zeros_like(limb)
    alone = np.concatenate([empty, limb] if side == "left" else [limb, empty])  # i grows towards the left
    expected = segmentation_from(two.with_values(alone))
    assert np.array_equal(found.skin.values, expected.skin.values)
    assert len(found.bones) == 2
    assert found.markers == expected.markers
    assert any(side in each for each in found.notes)


@pytest.mark.parametrize(("value", "message"), [(7, "value"), (0, "no voxel")])
def test_unusable_labels_are_refused(truth, tmp_path, value, message):
    values = truth.values.copy()
    values[values == 2] = value
    with pytest.raises(CaseError, match=message):
        checked_labels(Volume(values, truth.affine), tmp_path / "labels.nii.gz")


def test_a_file_that_is_no_nifti_is_refused(tmp_path):
    (tmp_path / "labels.nii.gz").write_text("nothing")
    with pytest.raises(CaseError, match="cannot be read"):
        read_nifti_labels(tmp_path / "labels.nii.gz")
