"""The pictures of what was read carry the scale that it was read in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from limbcli.measurement import instrument_pictures
from limbcli.measurement.bmode import BoneLine
from tests.measurement.test_bmode import frame, speckle


def test_images_with_their_bone_line_have_a_scale_of_depth(monkeypatch, rng):
    kept: list[Figure] = []
    monkeypatch.setattr(instrument_pictures, "save_picture", lambda figure, *_, **__: kept.append(figure))
    image = frame(rng, 300.0, speckle(rng))
    region = image.main_region()
    lines = [BoneLine(24.0, 0.1, 1.0)] * 7
    instrument_pictures.draw_bone_lines([image] * 7, lines, Path("a.png"))
    shown = [axes for axes in kept[0].axes if axes.axison]
    assert len(shown) == 7
    assert [bool(axes.get_ylabel()) for axes in shown] == [True, *[False] * 4, True, False]
    deepest = region.mm_per_pixel_y * (region.bottom - region.top + 1)
    for axes in shown:
        np.testing.assert_allclose(axes.get_ylim(), (deepest, 0.0))
        assert len(axes.get_yticks()) > 1
