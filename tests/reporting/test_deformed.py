"""Pictures of the deformed model: the nearest facet is drawn last, and gaps do not stop them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from limbcli.reporting.figures.deformed import DeformedState, section_figure
from limbcli.reporting.figures.skin import skin_figure

CORNERS = np.array(
    [[-1, -1, -2], [1, -1, -2], [1, 1, -2], [-1, 1, -2], [-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]
)
TETS = np.array([[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]])


def state(**changes: object) -> DeformedState:
    displacement = np.zeros((8, 3))
    displacement[4:, 2] = -0.5
    skin = {"quad4": np.array([[4, 5, 6, 7]])}
    cut = {"quad4": np.array([[0, 3, 2, 1], [0, 1, 5, 4]])}
    base = DeformedState(
        points=CORNERS, displacement=displacement, kind="tet4", cells=TETS, skin=skin, bone={},
        probe={"quad4": np.array([[4, 5, 6, 7]])},
        probe_shift=np.array([0.0, 0.0, -0.5]), depth=0.5, stretch=np.full(6, 0.75), cut=cut,
    )  # fmt: skip
    return replace(base, **changes)


def test_shortening_is_drawn_in_percent_on_the_moved_section():
    _, right, *_ = section_figure(state()).axes
    drawn = next(each for each in right.collections if each.get_array() is not None)
    np.testing.assert_allclose(drawn.get_array(), 25.0)
    corners = np.concatenate([path.vertices for path in drawn.get_paths()])
    assert corners[:, 1].max() == pytest.approx(-0.5)
    assert corners[:, 1].min() == pytest.approx(-2.0)


@pytest.mark.slow
@pytest.mark.parametrize(("half_width", "height"), [(47.5, 16.6), (95.0, 49.8)])
def test_a_probe_that_stands_high_does_not_push_the_titles_off_the_picture(half_width, height):
    """Tissue 83 mm deep, as wide as a limb or twice that, and a probe that rises above it (mm)."""
    tissue = CORNERS * [half_width, 40.0, 41.5]
    wall = np.array([[-20.0, 20, 0], [20, -20, 0], [20, -20, height], [-20, 20, height]])
    high = state(
        points=np.concatenate([tissue, wall]), displacement=np.zeros((12, 3)),
        probe={"quad4": np.array([[8, 9, 10, 11]])},
    )  # fmt: skip
    figure = section_figure(high)
    FigureCanvasAgg(figure).draw()
    assert max(each.get_tightbbox().y1 for each in figure.axes) <= figure.bbox.y1


def test_without_recorded_stretch_there_is_one_panel():
    figure = section_figure(state(stretch=None))
    assert (
        len([axes for axes in figure.axes if "mm" in axes.get_xlabel() and "long side" in axes.get_xlabel()])
        == 1
    )


def test_skin_shows_how_far_it_moved_and_the_cut_in_grey():
    figure = skin_figure(state())
    (drawn,) = (each for each in figure.axes[0].collections)
    colours = np.round(drawn.get_facecolor(), 3)
    assert len(colours) == 6
    greys = [each for each in colours if np.ptp(each[:3]) < 0.05]
    assert len(greys) == 4


def test_nearest_facet_is_drawn_last():
    """The upper face is nearer to a viewer above than the lower face."""
    figure = skin_figure(state(skin={"quad4": np.array([[4, 5, 6, 7], [0, 3, 2, 1]])}, cut={}))
    (drawn,) = figure.axes[0].collections
    heights = [path.vertices[:, 1].mean() for path in drawn.get_paths()]
    assert min(heights[2:]) > max(heights[:2])


def test_nodes_that_were_not_recorded_leave_a_gap():
    displacement = state().displacement.copy()
    displacement[5] = np.nan
    gap = state(displacement=displacement)
    section_figure(gap)
    (drawn,) = skin_figure(gap).axes[0].collections
    assert len(drawn.get_paths()) < 6


def test_section_names_the_side_it_points_to_and_what_is_grey():
    gaps = np.array([0.75, np.nan, 0.75, 0.75, 0.75, 0.75])
    figure = section_figure(state(stretch=gaps, sides=("left", "head")))
    assert "(+ is left)" in figure.axes[0].get_xlabel()
    assert [each.get_text() for each in figure.legends[0].get_texts()][-1] == "not recorded"
    whole = section_figure(state()).legends[0].get_texts()
    assert "not recorded" not in [each.get_text() for each in whole]


def test_skin_shows_bone_in_the_cut_and_which_way_the_patient_lies():
    figure = skin_figure(state(bone={"quad4": np.array([[0, 1, 5, 4]])}, sides=("left", "head")))
    assert [each.get_text() for each in figure.legends[0].get_texts()] == ["cut open", "bone"]
    arrows = {each.get_text(): np.array(each.xy) for each in figure.axes[0].texts if each.get_text()}
    assert arrows["left"][0] > arrows["20 mm"][0] - 40
    assert arrows["head"][1] > arrows["left"][1], "y goes up in this view, x down"
