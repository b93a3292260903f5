"""Images that are not the plain case: two limbs, CT, other contrasts, seeds, thresholds."""

from __future__ import annotations

import numpy as np
import pytest
from limb_images import Limb, dice

from limbcli.errors import CaseError
from limbcli.imaging.segmentation import FAT, SegmentationHints, segment_limb
from limbcli.imaging.volume import Volume

pytestmark = pytest.mark.slow

SHAPE = (104, 92, 12)
HU = {
    "air": -1000.0, "skin": 20.0, "fat": -100.0, "muscle": 60.0, "cortex": 1200.0, "marrow": 230.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def plain():
    return Limb().image(shape=SHAPE, samples=1)


@pytest.fixture(scope="module")
def pair(plain):
    """The limb and its mirror image side by side; the patient's left is at larger x."""
    image, truth = plain
    both = np.concatenate([image.values[::-1], image.values], axis=0)
    return Volume(both, image.affine), truth


def test_two_limbs_need_a_word_which(pair):
    with pytest.raises(CaseError, match="2 limbs") as caught:
        segment_limb(pair[0])
    assert "--limb" in caught.value.fix


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_wanted_limb_of_two_is_segmented(pair, side):
    image, truth = pair
    found = segment_limb(image, hints=SegmentationHints(side=side))
    assert any(f"the patient's {side} one" in note for note in found.notes)
    labels = found.labels.values
    half = labels[104:] if side == "left" else labels[:104][::-1]
    assert dice(half > 0, truth > 0) > 0.97
    assert dice(half == 2, truth == 2) > 0.95
    assert (labels > 0).sum() == (half > 0).sum()


def test_something_far_brighter_than_fat_does_not_move_the_skin(plain):
    """As an implant's rim: a bright rod through the muscle, 1.6 % of the image."""
    image, truth = plain
    rod = np.hypot(*(np.indices(SHAPE)[:2] - np.array([60.0, 62.0])[:, None, None, None])) < 7
    found = segment_limb(image.with_values(np.where(rod, 4000.0, image.values).astype(np.float32)))
    assert dice(found.labels.values > 0, truth > 0) > 0.98


def test_dark_fat_is_refused_with_the_way_out(plain):
    image, _ = Limb(signals={"fat": 90.0, "marrow": 90.0}).image(shape=SHAPE, samples=1)
    with pytest.raises(CaseError, match="fat is darker") as caught:
        segment_limb(image)
    assert "fat suppression" in caught.value.fix


def test_bright_air_is_turned_over_and_said(plain):
    image, truth = plain
    turned = image.with_values(1200.0 - image.values)
    found = segment_limb(turned)
    assert any("inverted" in note for note in found.notes)
    assert dice(found.labels.values == 2, truth == 2) > 0.95


def test_ct_is_segmented_by_hounsfield_units():
    image, truth = Limb(signals=HU).image(shape=SHAPE, samples=1)
    image = image.with_values(np.where(truth > 0, image.values, -1000.0))
    found = segment_limb(image, modality="CT")
    labels = found.labels.values
    assert dice(labels > 0, truth > 0) > 0.98
    assert dice(labels == 2, truth == 2) > 0.95
    assert len(found.bones) == 2


def test_ct_without_hounsfield_units_is_refused(plain):
    with pytest.raises(CaseError, match="not near -1000 HU"):
        segment_limb(plain[0], modality="CT")


def test_fat_is_labelled_where_it_is(plain):
    image, truth = plain
    labels = segment_limb(image).labels.values
    x, y, _ = np.moveaxis(image.to_patient(np.indices(SHAPE).reshape(3, -1).T).reshape(*SHAPE, 3), -1, 0)
    depth = (1 - np.hypot(x / 42.0, y / 36.0)) * 36.0
    fat = (depth > 1.6) & (depth < 6.5) & (truth == 1)
    assert dice(labels == FAT, fat) > 0.9


def test_without_contrast_fat_is_not_labelled_and_that_is_said():
    image, _ = Limb(signals={"fat": 400.0, "marrow": 420.0}).image(shape=SHAPE, samples=1)
    found = segment_limb(image)
    assert found.fat is None
    assert not (found.labels.values == FAT).any()
    assert any("label 4" in note for note in found.notes)


def test_a_seed_adds_a_bone_that_was_missed():
    """Cortex open on one side: the ring is not dark enough to be found unasked."""
    image, truth = Limb(bones=((-4.0, -14.0, 11.0, 3.0), (16.0, 2.0, 6.5, 0.0))).image(shape=SHAPE, samples=1)
    assert len(segment_limb(image).bones) == 1
    found = segment_limb(image, hints=SegmentationHints(bone_seeds=np.array([[16.0, 2.0, 0.0]])))
    assert len(found.bones) == 2
    assert dice(found.labels.values == 2, truth == 2) > 0.9


def test_a_soft_seed_takes_a_bone_away(plain):
    found = segment_limb(plain[0], hints=SegmentationHints(soft_seeds=np.array([[16.0, 2.0, 0.0]])))
    assert len(found.bones) == 1
    assert found.bones[0].values.sum() > 2000


def test_a_threshold_moves_the_skin(plain):
    image, _ = plain
    low, high = (
        int((segment_limb(image, hints=SegmentationHints(threshold=level)).labels.values > 0).sum())
        for level in (70, 500)
    )
    assert high < 0.97 * low


def test_air_alone_is_refused(rng):
    noise = Volume(rng.normal(10, 2, (40, 40, 8)).astype(np.float32), np.diag([1.0, 1.0, 4.0, 1.0]))
    with pytest.raises(CaseError, match="no limb"):
        segment_limb(noise)


def test_a_coronal_series_is_segmented_and_its_coarse_sections_are_said():
    image, truth = Limb().image(shape=(104, 32, 48), spacing=(1.0, 3.0, 1.0))
    found = segment_limb(image)
    assert dice(found.labels.values > 0, truth > 0) > 0.96
    assert dice(found.labels.values == 2, truth == 2) > 0.92  # the walls are thinner than a pixel
    assert any("3.0 mm" in note for note in found.notes)
