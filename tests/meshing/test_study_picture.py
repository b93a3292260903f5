"""The picture of a refinement study shows all that it names."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from limbcli.meshing import mesh_picture
from limbcli.meshing.mesh_extrapolation import Extrapolation


@pytest.mark.slow
def test_limit_and_title_are_on_the_picture(monkeypatch):
    kept: list[Figure] = []
    monkeypatch.setattr(mesh_picture, "save_figure", lambda figure, *_, **__: kept.append(figure))
    mesh_picture.study_picture(
        Path("a.png"), sizes=[(2.5, 10.0), (5.0, 6.0)], margins=[(40.0, 10.0)], used=(2.5, 40.0),
        extrapolation=Extrapolation(14.0, 1.0, True, (0.1, 0.2)), depth=8.0, title="a-long-name " * 40,
    )  # fmt: skip
    (figure,) = kept
    FigureCanvasAgg(figure).draw()
    assert figure.axes[0].get_ylim()[1] > 14.0
    assert figure.axes[1].get_ylim()[1] < 14.0
    box = figure._suptitle.get_window_extent()
    assert 0 <= box.x0 < box.x1 <= figure.bbox.x1
