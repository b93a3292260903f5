"""The picture of a joint fit: a panel with nothing to show says so."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

from limbcli.drawing import figure_data
from limbcli.fitting import joint_picture
from limbcli.inference.site_depth import SiteMeasurement, SitePrediction

FORCE = np.linspace(0.5, 8.0, 5)
LAYER_DATA = type(SiteMeasurement.__dataclass_fields__["layers"].default)


def site(name: str, *, speeds: bool, layers: bool) -> SiteMeasurement:
    n = 5 if speeds else 0
    reported = LAYER_DATA(FORCE, np.zeros(5, int), 6 - 0.1 * FORCE, 0.04 * np.eye(5), np.full(5, 6.0))
    more = {"layers": reported} if layers else {}
    return SiteMeasurement(
        name,
        FORCE,
        FORCE,
        FORCE**0.5,
        0.1,
        0.3,
        FORCE[:n],
        np.log(2 + 0.05 * FORCE[:n]),
        np.full(n, 0.05),
        **more,
    )


def test_sites_without_speeds_or_layers_have_panels_that_say_so(monkeypatch):
    sites = [site("a", speeds=True, layers=True), site("b", speeds=False, layers=False)]
    layers = [each.layers.thickness for each in sites]
    predicted = [
        SitePrediction(FORCE**0.5, FORCE, FORCE, each.log_speed, FORCE, thick, thick)
        for each, thick in zip(sites, layers, strict=True)
    ]
    kept: list[Figure] = []
    monkeypatch.setattr(joint_picture, "save_figure", lambda figure, path: kept.append(figure))
    writer = SimpleNamespace(file=lambda key, name: name)
    found = SimpleNamespace(profiles={}, best=np.zeros(0), threshold=3.84)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        joint_picture.draw_joint(sites, predicted, found, writer)
    words = [[each.get_text() for each in axes.texts] for axes in kept[0].axes]
    assert words == [[], [], [], [], ["no speeds enter"], ["no layers enter"]]
    assert not len(kept[0].axes[4].get_xticks())
    named = {(row[0], row[4]) for row in figure_data(kept[0])}
    assert {("site a, speed", "measured (±1 SD)"), ("site a, speed", "joint fit")} <= named
    assert {("site a, layers", "skin (±1 SD)"), ("site a, layers", "skin, joint fit")} <= named
