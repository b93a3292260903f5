"""The limb is shown from the side that a site faces, with the probe's face where it is."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.drawing import figure_data
from limbcli.reporting.figures.limb_views import LimbPlace, limb_place_figure

BOX = np.array([[x, y, z] for x in (-40.0, 40.0) for y in (-30.0, 30.0) for z in (0.0, 200.0)])
SIDES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]])


def placed(outward: tuple[float, float, float], place: tuple[float, float, float]) -> LimbPlace:
    along = np.cross([0.0, 0.0, 1.0], outward)
    face = np.array(place) + np.array([-20.0, 20.0, 20.0, -20.0])[:, None] * along
    face[:, 2] += [-5.0, -5.0, 5.0, 5.0]
    return LimbPlace(
        name="p1",
        limb="left",
        points=BOX,
        triangles=SIDES,
        place=np.array(place),
        outward=np.array(outward),
        face=face,
    )


@pytest.mark.parametrize(
    ("outward", "place", "view", "side"),
    [
        ((0.0, -1.0, 0.0), (0.0, -30.0, 150.0), "from the front (anterior)", "anterior"),
        ((1.0, 0.0, 0.0), (40.0, 0.0, 150.0), "from the patient's left", "lateral"),
        ((0.0, 1.0, 0.0), (0.0, 30.0, 150.0), "from the back (posterior)", "posterior"),
        ((-0.9, 0.3, 0.3), (-40.0, 0.0, 150.0), "from the patient's right", "medial"),
    ],
)
def test_a_limb_is_seen_from_the_side_of_its_site(outward, place, view, side):
    limb = placed(outward, place)
    assert limb.view.name == view
    assert limb.words == f"{side}, 150 mm above the lower end of the limb in the images"


def test_the_probes_face_is_drawn_at_its_place_and_left_is_where_the_viewer_sees_it():
    limb = placed((0.0, 1.0, 0.0), (10.0, 30.0, 150.0))
    figure = limb_place_figure(limb)
    (axes,) = figure.axes
    drawn = np.array([row[6:8] for row in figure_data(figure) if row[4] == "p1"], float)
    assert drawn.mean(axis=0)[1] == pytest.approx(150.0, abs=3.0)
    assert (drawn[:, 0].min(), drawn[:, 0].max()) == (-10.0, 30.0)
    low, high = axes.get_xlim()
    assert low > high, "seen from behind, the patient's left (+x) is on the left"
    assert {each.get_text(): each.get_position()[0] for each in axes.texts if each.get_text() in "LR"} == {
        "L": 0.0,
        "R": 1.0,
    }


def test_a_site_without_a_mesh_is_marked_by_a_cross():
    limb = placed((0.0, -1.0, 0.0), (0.0, -30.0, 50.0))
    figure = limb_place_figure(
        LimbPlace(name="p1", limb="left", points=BOX, triangles=SIDES, place=limb.place, outward=limb.outward)
    )
    assert [row[6:8] for row in figure_data(figure) if row[4] == "p1"] == [(0.0, 50.0)]
