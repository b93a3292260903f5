"""The contact sheet says which side is which, and which outline is what."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from limbcli.imaging import picture
from limbcli.imaging.picture import contact_sheet
from limbcli.imaging.segmentation import MARKER, Segmentation
from limbcli.imaging.volume import Volume


def _finer(mask: np.ndarray, affine: np.ndarray) -> Volume:
    """The same mask in voxels of half the width, as working masks are finer than an image."""
    halved = np.array([[0.5, 0, 0, -0.25], [0, 0.5, 0, -0.25], [0, 0, 1, 0], [0, 0, 0, 1]])
    return Volume(mask.repeat(2, axis=0).repeat(2, axis=1), affine @ halved)


def sheet(monkeypatch: pytest.MonkeyPatch, across: float, *, marker: bool) -> Figure:
    kept: list[Figure] = []
    monkeypatch.setattr(picture, "save_picture", lambda figure, *_, **__: kept.append(figure))
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


@pytest.mark.parametrize("across", [1.0, 0.5])
def test_outlines_lie_round_their_masks(monkeypatch, across):
    for axes in sheet(monkeypatch, across, marker=False).axes:
        (outlines,) = axes.collections
        skin, bone = (each.vertices for each in outlines.get_paths())
        assert np.allclose([skin.min(axis=0), skin.max(axis=0)], [[3.5 * across, 3.5], [19.5 * across, 15.5]])
        assert np.allclose([bone.min(axis=0), bone.max(axis=0)], [[7.5 * across, 7.5], [11.5 * across, 11.5]])
