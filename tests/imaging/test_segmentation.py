"""Automatic segmentation against limbs whose truth is known, and against outlines drawn by eye."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from limb_images import Limb, dice
from scipy import ndimage
from skimage.draw import polygon2mask

from limbcli.errors import CaseError
from limbcli.imaging.bones import name_bones
from limbcli.imaging.dicom import read_series
from limbcli.imaging.segmentation import SegmentationHints, segment_limb
from limbcli.imaging.volume import Volume, back
from limbcli.phantom.mri import acquire, tissue_fractions
from limbcli.phantom.subject import make_subject

OUTLINES = Path(__file__).parents[1] / "data" / "calf-outlines.json"
MARKERS = ((43.5, 0.0, -8.0), (0.0, 38.0, 12.0))


def skin_and_bone_dice(labels, truth):
    return dice(np.isin(labels, (1, 2, 4)), np.isin(truth, (1, 2))), dice(labels == 2, truth == 2)


def test_a_simple_limb_is_found_with_bones_and_markers():
    image, truth = Limb(markers=MARKERS).image()
    found = segment_limb(image)
    skin, bone = skin_and_bone_dice(found.labels.values, truth)
    assert skin >= 0.98
    assert bone >= 0.97
    assert name_bones(found.bones) == ("tibia", "fibula")
    np.testing.assert_allclose([each.position for each in found.markers], MARKERS, atol=1.5)


@pytest.mark.parametrize(
    ("hints", "message"),
    [({"bone_seeds": (400.0, 0.0, 0.0)}, "bone=400,0,0 lies outside of the image"),
     ({"soft_seeds": (-60.0, 0.0, 0.0)}, "soft=-60,0,0 lies outside of the image"),
     ({"bone_seeds": (-49.0, -40.0, 0.0)}, "lies outside the limb")],
)  # fmt: skip
def test_seeds_that_lie_nowhere_are_refused(coarse, hints, message):
    with pytest.raises(CaseError, match=message):
        segment_limb(coarse, hints=SegmentationHints(**{kind: np.array([at]) for kind, at in hints.items()}))


def test_a_seed_that_changes_nothing_is_told(coarse):
    found = segment_limb(coarse, hints=SegmentationHints(soft_seeds=np.array([[30.0, 0.0, 0.0]])))
    assert any("has no effect" in each for each in found.notes)


@pytest.fixture(scope="module")
def coarse():
    return Limb().image(shape=(52, 46, 8), spacing=(2.0, 2.0, 6.0), samples=1)[0]


def test_bones_that_end_inside_the_limb_end_there_with_their_cap_of_cortex():
    image, truth = Limb(bone_end=-10.0).image(shape=(104, 92, 24), spacing=(1.0, 1.0, 2.0), samples=1)
    found = segment_limb(image)
    assert skin_and_bone_dice(found.labels.values, truth)[1] >= 0.96
    for bone in found.bones:
        first = np.flatnonzero(bone.values.any(axis=(0, 1)))[0]
        end = image.to_patient(np.array([[0.0, 0.0, first - 0.5]]))[0, 2]
        assert end == pytest.approx(-10.0, abs=1.1)


def test_a_bright_vessel_is_no_bone():
    image, _ = Limb(bones=((-4.0, -14.0, 11.0, 3.0), (14.0, 6.0, 3.0, 0.0))).image(samples=1)
    found = segment_limb(image)
    assert len(found.bones) == 1


@pytest.mark.slow
def test_a_knee_in_view_gives_femur_and_patella_too():
    shank = ((0.0, -4.0, 16.0, 1.5, -200.0, 0.0), (20.0, 10.0, 6.0, 2.0, -200.0, -12.0))
    thigh = ((0.0, 0.0, 18.0, 1.5, 6.0, 200.0), (0.0, -27.0, 6.0, 1.5, 10.0, 34.0))
    limb = Limb(half_width=48.0, half_depth=44.0, bones=shank + thigh)
    image, truth = limb.image(shape=(108, 100, 28), spacing=(1.0, 1.0, 4.0), samples=1)
    found = segment_limb(image)
    assert set(name_bones(found.bones)) == {"tibia", "fibula", "femur", "patella"}
    assert skin_and_bone_dice(found.labels.values, truth)[1] >= 0.95


def test_the_result_does_not_depend_on_how_the_axes_lie():
    image, _ = Limb().image(shape=(104, 92, 12), samples=1)
    straight = segment_limb(image).labels.values
    affine = image.affine[:, [2, 0, 1, 3]].copy()
    affine[:3, 3] += affine[:3, 0] * 11
    affine[:3, 0] *= -1
    turned = Volume(np.transpose(image.values, (2, 0, 1))[::-1], affine)
    found = segment_limb(turned).labels
    assert np.array_equal(np.transpose(found.values[::-1], (1, 2, 0)), straight)
    assert found.shape == turned.shape


def test_turning_along_the_limb_and_back_changes_nothing(rng):
    volume = Volume(rng.random((4, 5, 6)), np.diag([-2.0, 3.0, -1.0, 1.0]))
    turned, order, flipped = volume.along_limb()
    assert np.array_equal(back(turned.values, order, flipped), volume.values)
    index = np.array([[1.0, 2.0, 0.0]])
    assert turned.values[1, 2, 0] == volume.values[1, 2, 5]
    np.testing.assert_allclose(turned.to_patient(index), volume.to_patient(np.array([[1.0, 2.0, 5.0]])))


@pytest.mark.parametrize(
    "voxel",
    [
        (2.0, 2.0, 4.0),
        pytest.param((1.0, 1.0, 4.0), marks=pytest.mark.slow),
        pytest.param((2.0, 2.0, 2.0), marks=pytest.mark.slow),
    ],
)
def test_the_phantom_is_segmented_to_a_dice_of_0_97(voxel, rng):
    subject = make_subject(rng, voxel=voxel)
    fractions = tissue_fractions(
        subject.anatomy, subject.grid, subject.limb_from_patient, supersampling=(2, 2, 2)
    )
    image = acquire(fractions, subject.grid, rng=rng)
    found = segment_limb(Volume(image.signal.astype(np.float32), subject.grid.patient_from_index))
    skin, bone = skin_and_bone_dice(found.labels.values, image.labels)
    assert skin >= 0.97
    assert bone >= 0.97
    assert name_bones(found.bones) == ("tibia", "fibula")
    np.testing.assert_allclose(
        [each.position for each in found.markers], subject.marker_positions(), atol=1.0
    )


def mean_surface_distance(a, b, pixel):
    edges = [each & ~ndimage.binary_erosion(each) for each in (a, b)]
    distances = [ndimage.distance_transform_edt(~each) * pixel for each in edges]
    return 0.5 * (distances[1][edges[0]].mean() + distances[0][edges[1]].mean())


@pytest.mark.slow
def test_the_real_calf_agrees_with_outlines_drawn_by_eye(shared):
    series = read_series(shared / "data" / "calf-mri")
    found = segment_limb(series.volume)
    masks = {"skin": found.skin, **dict(zip(name_bones(found.bones), found.bones, strict=True))}
    overlap, distances = {}, {}
    for k, outlines in json.loads(OUTLINES.read_text())["slices"].items():
        for name, polygon in outlines.items():
            drawn = polygon2mask(found.skin.shape[:2], np.array(polygon))
            auto = masks[name].values[:, :, int(k)]
            group = "skin" if name == "skin" else "bone"
            overlap.setdefault(group, []).append((2 * (drawn & auto).sum(), drawn.sum() + auto.sum()))
            pixel = float(series.volume.spacing[0])
            distances.setdefault(group, []).append(mean_surface_distance(drawn, auto, pixel))
    shares = {group: np.sum(pairs, axis=0) for group, pairs in overlap.items()}
    assert shares["skin"][0] / shares["skin"][1] >= 0.985
    assert shares["bone"][0] / shares["bone"][1] >= 0.93
    assert np.mean(distances["skin"]) <= 0.7
    assert np.mean(distances["bone"]) <= 0.7
