"""The contact sheet says which side is which, and which outline is what."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from limbcli.imaging import segmentation_picture
from limbcli.imaging.segmentation import MARKER, Segmentation
from limbcli.imaging.segmentation_picture import contact_sheet, slice_axes
from limbcli.imaging.volume import Volume


def _finer(mask: np.ndarray, affine: np.ndarray) -> Volume:
    """The same mask in voxels of half the width, as working masks are finer than an image."""
    halved = np.array([[0.5, 0, 0, -0.25], [0, 0.5, 0, -0.25], [0, 0, 1, 0], [0, 0, 0, 1]])
    return Volume(mask.repeat(2, axis=0).repeat(2, axis=1), affine @ halved)


def sheet(monkeypatch: pytest.MonkeyPatch, across: float, *, marker: bool) -> Figure:
    kept: list[Figure] = []
    monkeypatch.setattr(segmentation_picture, "save_picture", lambda figure, *_, **__: kept.append(figure))
    affine = np.diag([across, 1.0, 3.0, 1.0])
    inside = np.zeros((24, 20, 4), bool)
    inside[4:20, 4:16] = True
    bone = np.zeros_like(inside)
    bone[8:12, 8:12] = True
    labels = inside + bone.astype(np.uint8)
    if marker:
        labels[19, 15, 2] = MARKER
    found = Segmentation(Volume(labels, affine), _finer(inside, affine), (_finer(bone, affine),))
    contact_sheet(Path("a.png"), Volume(100.0 * inside, affine), found, ["tibia"], title="p " * 200)
    return kept[0]


@pytest.mark.parametrize(("across", "left_edge", "right_edge"), [(1.0, "R", "L"), (-1.0, "L", "R")])
def test_sides_of_the_patient_are_told(monkeypatch, across, left_edge, right_edge):
    for axes in sheet(monkeypatch, across, marker=False).axes:
        letters = {each.get_position(): each.get_text() for each in axes.texts}
        assert (letters[0.02, 0.5], letters[0.98, 0.5]) == (left_edge, right_edge)
        assert (letters[0.5, 0.98], letters[0.5, 0.02]) == ("A", "P")


def test_legend_names_the_outlines_that_are_there(monkeypatch):
    for marker, names in ((False, ["skin", "tibia"]), (True, ["skin", "tibia", "marker"])):
        figure = sheet(monkeypatch, 1.0, marker=marker)
        assert [each.get_text() for each in figure.legends[0].get_texts()] == names


@pytest.mark.parametrize("across", [1.0, 0.5, -1.0])
def test_outlines_lie_round_their_masks_in_patient_coordinates(monkeypatch, across):
    for axes in sheet(monkeypatch, across, marker=False).axes:
        (outlines,) = axes.collections
        assert axes.xaxis.label.get_text() == "x (LPS), mm"
        for each, (low, high) in zip(outlines.get_paths(), ((3.5, (19.5, 15.5)), (7.5, 11.5)), strict=True):
            corners = np.array([[low, low], np.broadcast_to(high, 2)]) * [across, 1.0]
            found = [each.vertices.min(axis=0), each.vertices.max(axis=0)]
            assert np.allclose(found, [corners.min(axis=0), corners.max(axis=0)])


@pytest.mark.parametrize(("turned_deg", "is_lps"), [(0.5, True), (10.0, False)])
def test_axes_of_slices_oblique_to_the_patient_are_not_called_lps(turned_deg, is_lps):
    t = np.radians(turned_deg)
    affine = np.eye(4)
    affine[:2, :2] = [[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]
    affine[:3, 3] = [5.0, -7.0, 30.0]
    across, _ = slice_axes(Volume(np.zeros((100, 80, 4)), affine), (slice(0, 100), slice(0, 80), slice(0, 4)))
    assert ("not LPS" not in across.label) == is_lps
    if is_lps:
        place = Volume(np.zeros((1, 1, 1)), affine).to_patient(np.array([[80.0, 60.0, 2.0]]))[0]
        assert across(np.array([80.0])) == pytest.approx(place[0], abs=1.0)
