"""The picture of places shows from each side what can be seen from there, and tells its marks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from limbcli.meshing.mending import mend
from limbcli.meshing.surfaces import Triangles
from limbcli.stages.segmenting import site_grid
from limbcli.stages.segmenting.site_grid import GridPoint, grid_points


def slanted_limb() -> Triangles:
    """A closed tube, 300 mm long and 40 mm wide, whose distal end lies 150 mm behind its proximal end."""
    n, rows = 24, 31
    angle, z = np.meshgrid(2 * np.pi * np.arange(n) / n, np.linspace(0, 300, rows))
    ring = np.stack([20 * np.cos(angle), 20 * np.sin(angle) + 150 - 0.5 * z, z], axis=-1).reshape(-1, 3)
    points = np.vstack([ring, [0, 150, 0], [0, 0, 300]])
    k, i = np.meshgrid(np.arange(n), np.arange(rows - 1))
    a, b = (i * n + k).ravel(), (i * n + (k + 1) % n).ravel()
    sides = np.vstack([np.c_[a, b, b + n], np.c_[a, b + n, a + n]])
    turn, top = np.arange(n), (rows - 1) * n
    foot = np.c_[np.full(n, rows * n), (turn + 1) % n, turn]
    head = np.c_[np.full(n, rows * n + 1), top + turn, top + (turn + 1) % n]
    return Triangles(points, np.vstack([sides, foot, head]))


def drawn(
    monkeypatch: pytest.MonkeyPatch,
    title: str,
    sites: dict[str, np.ndarray],
    markers: dict[str, np.ndarray] | None = None,
) -> tuple[Figure, list[GridPoint]]:
    kept: list[Figure] = []
    monkeypatch.setattr(site_grid, "save_picture", lambda figure, *_, **__: kept.append(figure))
    limb = mend(slanted_limb(), [])
    grid = grid_points(limb)
    site_grid.draw_places(Path("a.png"), limb, grid, markers or {}, sites, title=title)
    FigureCanvasAgg(kept[0]).draw()
    return kept[0], grid


@pytest.mark.slow
def test_no_point_is_shown_through_a_slanted_limb(monkeypatch):
    figure, grid = drawn(monkeypatch, "p", {})
    angle = {each.name: each.angle_deg for each in grid}
    for axes, middle in zip(figure.axes, (0, 90, 180, 270), strict=True):
        shown = [angle[each.get_text()] for each in axes.texts]
        off = [abs((each - middle + 180) % 360 - 180) for each in shown]
        assert len(shown) >= len(grid) / 4
        assert max(off) < 90, axes.get_title()


@pytest.mark.slow
def test_title_stays_on_the_picture_and_the_legend_names_what_is_there(monkeypatch):
    site = np.array([0.0, 75 - 20.0, 150.0])
    figure, _ = drawn(monkeypatch, "a-very-long-name-of-a-subject-" * 8, {"p1": site})
    box = figure._suptitle.get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1
    words = [each.get_text() for each in figure.legends[0].get_texts()]
    assert words == ["point of the grid", "site of the case"]


@pytest.mark.slow
def test_a_site_on_a_marker_does_not_hide_its_name(monkeypatch):
    place = np.array([0.0, 75 - 20.0, 150.0])
    figure, _ = drawn(monkeypatch, "p", {"p1": place}, {"1": place})
    boxes = [
        each.get_window_extent() for each in figure.axes[0].texts if each.get_text() in ("p1", "marker 1")
    ]
    assert len(boxes) == 2
    assert not boxes[0].overlaps(boxes[1])


@pytest.mark.slow
def test_all_views_have_one_scale_and_words_stay_in_them(monkeypatch):
    aside = np.array([-14.0, -9.0, 290.0])  # at the right edge of the last view
    figure, _ = drawn(monkeypatch, "p", {"a-site-with-a-long-name": aside})
    scales = []
    for axes in figure.axes:
        box = axes.get_window_extent()
        scales += [box.width / abs(np.diff(axes.get_xlim())[0]), box.height / np.diff(axes.get_ylim())[0]]
        title = axes.title.get_window_extent()
        assert box.x0 <= title.x0
        assert title.x1 <= box.x1
        for name in axes.texts:
            assert figure.bbox.x0 <= name.get_window_extent().x0
            assert name.get_window_extent().x1 <= figure.bbox.x1
    assert np.ptp(scales) < 1e-9 * max(scales)
