"""Every drawing has units on its axes and shows what it was given."""

from __future__ import annotations

import re
from itertools import pairwise

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from limbcli.drawing import figure_data
from limbcli.interval_limits import THRESHOLD_95
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.regression import Line, speed_against_force
from limbcli.reporting.figures.cohort import compliance
from limbcli.reporting.figures.convergence import FitWalk, Residuals, fit_walk, newton_residuals
from limbcli.reporting.figures.force_depth import MeasuredCurve, SimulatedCurve, force_depth
from limbcli.reporting.figures.profiles import ProfileCurve, profile_figure
from limbcli.reporting.figures.speed_maps import LevelMaps, chosen_levels, speed_maps
from limbcli.reporting.figures.stiffness import StiffnessSection, stiffness_figure
from limbcli.reporting.figures.wave_speed import PredictedSpeeds, SpeedReadings, line_words, wave_speed

DEPTH = np.linspace(0, 10, 11)
MEASURED = MeasuredCurve(DEPTH, 1.5 * DEPTH, 0.3, 0.1)
SPEEDS = SpeedReadings(1.5 * DEPTH, DEPTH, 2.0 + 0.1 * DEPTH, np.full(11, 0.2))


def curve(key: str, factor: float) -> SimulatedCurve:
    return SimulatedCurve(key, key, DEPTH, factor * DEPTH, factor * DEPTH)


def maps(n: int, *, measured: bool) -> list[LevelMaps]:
    lateral, depth = (each.ravel() for each in np.meshgrid(np.arange(-3.0, 4), np.arange(2.0, 8)))
    own = SweMap(lateral, depth, 2.0 + 0.1 * depth)
    other = SweMap(lateral[5:], depth[5:], 1.7 + 0.1 * depth[5:]) if measured else None
    return [LevelMaps(k, 2.0 * k, own, other) for k in range(n)]


def tetrahedron() -> StiffnessSection:
    points = np.array([[0.0, -1, 0], [9, 1, 0], [0, 1, -9], [9, -1, -9]])
    return StiffnessSection(points, "tet4", np.arange(4)[None], np.array([8.0]), DEPTH, DEPTH)


def figures() -> dict[str, Figure]:
    curves = [curve("start", 9.0), curve("mooney-rivlin", 1.4), curve("ogden", 1.5)]
    line = speed_against_force(SPEEDS.force, SPEEDS.mean_m_per_s)
    walk = FitWalk("ogden", "Ogden type", np.array([5.0, 1.0]), {"f_kappa": np.array([100.0, 80.0])})
    return {
        "force-depth": force_depth(MEASURED, curves),
        "measured only": force_depth(MEASURED, ()),
        "wave speed": wave_speed(SPEEDS, against_force=line, against_depth=None),
        "predicted speed": wave_speed(None, predicted=PredictedSpeeds(DEPTH, DEPTH, 2.0 + 0.1 * DEPTH)),
        "speed maps": speed_maps(maps(7, measured=True)),
        "stiffness": stiffness_figure(tetrahedron()),
        "walk": fit_walk([walk]),
        "newton": newton_residuals(Residuals(np.array([9.0, 0.1, 3.0, 0.2]), np.array([1, 1, 2, 2]))),
    }


@pytest.mark.parametrize("name", figures())
def test_every_labelled_axis_names_its_unit(name):
    for axes in figures()[name].axes:
        for label in (axes.get_xlabel(), axes.get_ylabel()):
            if label and "iteration" not in label:
                assert re.search(r"\[[^\]]+\]", label), label
        assert axes.get_xlabel() or axes.get_ylabel() or axes.get_subplotspec() is not None


def test_a_start_curve_far_off_does_not_flatten_the_data():
    upper, lower = force_depth(MEASURED, [curve("start", 50.0), curve("ogden", 1.5)]).axes
    assert upper.get_ylim()[1] < 2 * 15.0
    assert lower.get_ylim()[1] < 1.0


def test_drawing_leaves_the_callers_settings_alone():
    before = dict(matplotlib.rcParams)
    figures()
    assert dict(matplotlib.rcParams) == before


def test_speed_maps_show_measured_predicted_and_the_difference_of_a_handful_of_levels():
    levels = maps(13, measured=True)
    assert [each.level for each in chosen_levels(levels)] == [0, 3, 6, 9, 12]
    panels = [axes for axes in speed_maps(levels).axes if axes.get_label() != "<colorbar>"]
    assert len(panels) == 3 * 5
    gaps = panels[-1].collections[0].get_array()
    assert len(gaps) == len(levels[0].measured.lateral)
    np.testing.assert_allclose(gaps, 0.3, rtol=1e-9)


def test_without_measured_maps_only_the_predicted_ones_are_drawn():
    panels = [a for a in speed_maps(maps(2, measured=False)).axes if a.get_label() != "<colorbar>"]
    assert len(panels) == 2


def test_a_falling_speed_is_written_with_a_minus():
    assert line_words(Line(-0.05, 2.0, 0.5, None, 3), "N").startswith("2.00 m/s − 0.050 m/s per N")


def test_an_undefined_r2_is_said_in_words():
    assert "R² undefined" in line_words(Line(0.0, 2.0, None, None, 3), "N")


@pytest.mark.parametrize(("low", "high"), [(0.01, 1000.0), (1.0, 190.0), (3.0, 40.0)])
def test_labels_of_a_profile_do_not_touch(low, high):
    values = np.geomspace(low, high, 20)
    curves = [ProfileCurve(name, values, np.linspace(0, 5, 20), low) for name in ("f_kappa", "m")]
    figure = profile_figure(curves)
    FigureCanvasAgg(figure).draw()
    for axes in figure.axes:
        boxes = [each.get_window_extent() for each in axes.get_xticklabels() if each.get_text()]
        inside = [each for each in boxes if axes.bbox.x0 <= (each.x0 + each.x1) / 2 <= axes.bbox.x1]
        assert len(inside) >= 2
        assert all(one.x1 < other.x0 for one, other in pairwise(inside))


def test_profile_is_shaded_to_where_it_crosses_the_limit():
    values = np.linspace(1.0, 9.0, 33)
    crossing = 2.0 * np.sqrt(THRESHOLD_95)
    whole = ProfileCurve("m", values, ((values - 5.0) / 2.0) ** 2, 5.0)
    open_above = ProfileCurve(
        "f_kappa", values, np.where(values < 5.0, ((values - 5.0) / 2.0) ** 2, 0.0), 5.0
    )
    estimated = ProfileCurve("m", values, whole.deviance, 5.0, limit=2.25)
    panels = profile_figure([whole, open_above, estimated]).axes
    ends_of = [(5.0 - crossing, 5.0 + crossing), (5.0 - crossing, 9.0), (2.0, 8.0)]
    for axes, ends in zip(panels, ends_of, strict=True):
        (shade,) = axes.patches
        low, high = shade.get_x(), shade.get_x() + shade.get_width()
        assert (low, high) == pytest.approx(ends, abs=0.02)


def test_sites_of_a_cohort_are_labelled_as_they_are_named():
    sites = [r"x$\q$", "_left", "cost $1$"]
    rows = [
        {"location": each, "measured_mm_per_mpa": 10.0 + k, "predicted_mm_per_mpa": 11.0}
        for k, each in enumerate(sites)
    ]
    figure = compliance(rows)
    FigureCanvasAgg(figure).draw()
    shown = [each.get_text() for each in figure.axes[0].get_legend().get_texts()]
    assert [each.strip().replace(r"\$", "$") for each in shown[1:]] == sorted(sites)
    assert set(sites) <= {row[4] for row in figure_data(figure)}
