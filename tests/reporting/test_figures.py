"""Every drawing has units on its axes and shows what it was given."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from limbcli.cohorts.figures import compliance, distributions
from limbcli.drawing import figure_data
from limbcli.fitting.joint_picture import profile_figure
from limbcli.fitting.layer_comparison import layers_figure
from limbcli.fitting.states_result import StateReading, StatesPanel, states_figure
from limbcli.fitting.stiffness_map import stiffness_figure
from limbcli.inference.profile import Profile
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.regression import Line, speed_line
from limbcli.model import Block, ElementMap, Mesh
from limbcli.numbers.interval_limits import THRESHOLD_95
from limbcli.reporting.figures.convergence import FitWalk, Residuals, fit_walk, newton_residuals
from limbcli.reporting.figures.force_depth import MeasuredCurve, SimulatedCurve, force_depth
from limbcli.reporting.figures.hysteresis_loops import Loop, cycles
from limbcli.reporting.figures.speed_maps import LevelMaps, chosen_levels, speed_maps
from limbcli.reporting.figures.style import plain_log
from limbcli.reporting.figures.wave_speed import PredictedSpeeds, SpeedReadings, line_text, wave_speed
from limbcli.reporting.fit_view import EstimateView
from limbcli.stages.report_pages.index import study_figure

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


def tetrahedron() -> Mesh:
    points = np.array([[0.0, -1, 0], [9, 1, 0], [0, 1, -9], [9, -1, -9]])
    return Mesh(points, (Block("tissue", "tet4", np.arange(4)[None]),))


def figures() -> dict[str, Figure]:
    curves = [curve("start", 9.0), curve("mooney-rivlin", 1.4), curve("ogden", 1.5)]
    line = speed_line(SPEEDS.force, SPEEDS.mean_m_per_s, against="force")
    walk = FitWalk("ogden", "Ogden type", np.array([5.0, 1.0]), {"f_kappa": np.array([100.0, 80.0])})
    return {
        "force-depth": force_depth(MEASURED, curves),
        "measured only": force_depth(MEASURED, ()),
        "wave speed": wave_speed(SPEEDS, against_force=line, against_depth=None),
        "predicted speed": wave_speed(None, predicted=PredictedSpeeds(DEPTH, DEPTH, 2.0 + 0.1 * DEPTH)),
        "speed maps": speed_maps(maps(7, measured=True)),
        "stiffness": stiffness_figure(
            tetrahedron(), ElementMap("c", "tissue", np.array([0.008])), SweMap(DEPTH, DEPTH, DEPTH)
        ),
        "walk": fit_walk([walk]),
        "newton": newton_residuals(Residuals(np.array([9.0, 0.1, 3.0, 0.2]), np.array([1, 1, 2, 2]))),
    }


@pytest.mark.slow
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


def test_a_simulation_that_no_fit_stands_beside_is_seen_whole():
    start = curve("start", 50.0)
    assert force_depth(MEASURED, [start]).axes[0].get_ylim()[1] > start.force.max()


@pytest.mark.slow
def test_drawing_leaves_the_callers_settings_alone():
    before = dict(matplotlib.rcParams)
    figures()
    assert dict(matplotlib.rcParams) == before


@pytest.mark.slow
def test_speed_maps_show_measured_predicted_and_the_difference_of_a_handful_of_levels():
    levels = maps(13, measured=True)
    assert [each.level for each in chosen_levels(levels)] == [0, 3, 6, 9, 12]
    panels = [axes for axes in speed_maps(levels).axes if axes.get_label() != "<colorbar>"]
    assert len(panels) == 3 * 5
    gaps = panels[-1].collections[0].get_array()
    assert len(gaps) == len(levels[0].measured.lateral)
    np.testing.assert_allclose(gaps, 0.3, rtol=1e-9)


def test_pixels_of_a_speed_map_fill_it_and_maps_without_a_common_pixel_are_drawn():
    lateral, depth = (each.ravel() for each in np.meshgrid(np.arange(0.0, 8, 2), np.arange(2.0, 5, 0.5)))
    own = SweMap(lateral, depth, 2.0 + 0.1 * depth)
    other = SweMap(lateral + 0.3, depth, own.speed_m_per_s)
    panels = [a for a in speed_maps([LevelMaps(0, 0.0, own, other)]).axes if a.get_label() != "<colorbar>"]
    corners = panels[1].collections[0].get_paths()[0].vertices
    np.testing.assert_allclose(np.ptp(corners, axis=0), [2.0, 0.5])
    assert [each.get_text() for each in panels[2].texts] == ["no pixel\nof both"]


def test_without_measured_maps_only_the_predicted_ones_are_drawn():
    panels = [a for a in speed_maps(maps(2, measured=False)).axes if a.get_label() != "<colorbar>"]
    assert len(panels) == 2


def test_a_falling_speed_is_written_with_a_minus():
    assert line_text(Line(-0.05, 2.0, 0.5, None, 3), "N").startswith("2.00 m/s − 0.050 m/s per N")


def test_an_undefined_r2_is_said_in_words():
    assert "R² undefined" in line_text(Line(0.0, 2.0, None, None, 3), "N")


@pytest.mark.slow
@pytest.mark.parametrize(("low", "high"), [(0.01, 1000.0), (1.0, 190.0), (3.0, 40.0)])
def test_labels_of_a_profile_do_not_touch(low, high):
    values = np.geomspace(low, high, 20)
    curves = {name: profile(name, values, np.linspace(0, 5, 20)) for name in ("f_kappa", "m")}
    figure = profile_figure(curves, np.array([low, low]), THRESHOLD_95)
    FigureCanvasAgg(figure).draw()
    for axes in figure.axes:
        boxes = [each.get_window_extent() for each in axes.get_xticklabels() if each.get_text()]
        inside = [each for each in boxes if axes.bbox.x0 <= (each.x0 + each.x1) / 2 <= axes.bbox.x1]
        assert len(inside) >= 2
        assert all(one.x1 < other.x0 for one, other in pairwise(inside))


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


def drawn(figure: Figure) -> Figure:
    FigureCanvasAgg(figure).draw()
    return figure


@pytest.mark.slow
def test_no_legend_lies_over_what_is_drawn():
    """A start curve far off, unloading, a search that falls steeply, cycles, states that are alike."""
    back = np.r_[np.zeros(9, bool), True, True]
    measured = MeasuredCurve(DEPTH, 1.5 * DEPTH, 0.3, 0.1, unloading=back)
    cost = np.array([40.0, 20.0, 12.0, 8.0, 4.5])
    walks = [FitWalk(key, key, cost, {"m": cost}) for key in ("mooney-rivlin", "ogden")]
    loops = [Loop(k, (DEPTH, DEPTH**0.5), (DEPTH[::-1], DEPTH[::-1])) for k in range(1, 13)]
    readings = [StateReading(f"state {k}", 1.0 + 1e-3 * k, 0.9, 1.2, 2.0, 0.1) for k in range(4)]
    panel = StatesPanel(
        way="along",
        counted="case",
        readings=readings,
        stretch=0.9 + DEPTH / 30,
        speed=2.0 + DEPTH,
        unloaded=1.0,
        lowest=None,
    )
    place = np.geomspace(1.0, 20.0, 20)
    valley = profile("m", place, np.log(place / 4.0) ** 2)
    for figure in (
        force_depth(measured, [curve("start", 9.0), curve("ogden", 1.5)]),
        fit_walk(walks), cycles(loops), states_figure([panel]),
        profile_figure({"m": valley}, np.array([4.0]), THRESHOLD_95),
        wave_speed(SPEEDS, against_force=Line(0.05, 2.0, None, None, 3), against_depth=None),
    ):  # fmt: skip
        drawn(figure)
        legends = [*figure.legends, *(each for axes in figure.axes if (each := axes.get_legend()))]
        assert legends
        for box in (each.get_window_extent() for each in legends):
            assert not any(box.overlaps(axes.bbox) for axes in figure.axes)
            assert 0 <= box.x0 < box.x1 <= figure.bbox.x1 + 1


def profile(name: str, values: np.ndarray, deviance: np.ndarray) -> Profile:
    low, high = values[0], values[-1]
    return Profile(name, values, deviance, values[:, None], low, high, False, False, values)


def test_a_misfit_of_nothing_does_not_squeeze_the_others():
    walk = FitWalk("ogden", "Ogden type", np.array([10.0, 1e-3, 0.0]), {"m": np.array([2.0, 3.0, 3.0])})
    assert fit_walk([walk]).axes[0].get_ylim()[0] > 1e-10


def test_forces_below_zero_stay_on_the_picture():
    below = MeasuredCurve(DEPTH, -DEPTH, 0.3, 0.1)
    low, high = force_depth(below, [curve("ogden", -1.0)]).axes[0].get_ylim()
    assert low < -10.1
    assert high > 0.0


@pytest.mark.slow
def test_differences_to_unloading_are_no_part_of_the_fits_line():
    back = np.r_[np.zeros(9, bool), True, True]
    measured = MeasuredCurve(DEPTH, 1.5 * DEPTH, 0.3, 0.1, unloading=back)
    lower = force_depth(measured, [curve("ogden", 1.4)]).axes[1]
    up, down = lower.lines[:2]
    assert (len(up.get_xdata()), len(down.get_xdata())) == (9, 2)
    assert down.get_linestyle() == "None"
    assert down.get_markerfacecolor() == "white"


def test_tables_beside_figures_name_every_curve():
    back = np.r_[np.zeros(9, bool), True, True]
    measured = MeasuredCurve(DEPTH, 1.5 * DEPTH, 0.3, 0.1, unloading=back)
    loops = [Loop(k, (DEPTH, DEPTH), (DEPTH[::-1], DEPTH), 3.0, 1.0, 0.1) for k in (1, 2)]
    known = EstimateView(name="c", value=5.0, unit="kPa", low=4.0, high=7.0, flag="fixed")
    rows = [("A p1", {"c": known}), ("B p1", {"c": replace(known, high=None, flag="weak")})]
    middle = {"beyond_family": None, "geometric_mean": 2.0, "spread_factor": 1.2, "low": 1.8, "high": 2.2}
    names = ("c_muscle_kpa", "c_fat_kpa", "m")
    person = {"location": "thigh", **{f"{k}{end}": 2.0 for k in names for end in ("", "_low", "_high")}}
    for figure, reported in (
        (force_depth(measured, [curve("start", 2.0), curve("ogden", 1.4)]), {"ogden", "ogden, unloading"}),
        (cycles(loops), {"cycle 2", "cycle 2, unloading"}),
        (study_figure(rows), {"A p1", "A p1, 95 %", "B p1, above"}),
        (distributions([person], {"thigh": {"population": dict.fromkeys(names, middle)}}),
         {"thigh", "thigh, 95 %", "thigh, spread between people"}),
    ):  # fmt: skip
        series = {row[4] for row in figure_data(figure)}
        assert reported <= series
        assert not [name for name in series if name.isdigit()]
    texts = [each.get_text() for each in cycles(loops).axes[0].get_legend().get_texts()]
    assert texts == ["cycle 1", "cycle 2"], "unloading is said in its title"


def test_bars_are_named_only_where_there_are_some():
    bare = SpeedReadings(DEPTH, DEPTH, 2.0 + DEPTH, np.full(11, np.nan))
    for readings, words in ((SPEEDS, "measured: mean ± SD over pixels"), (bare, "measured: mean")):
        legend = wave_speed(readings).axes[0].get_legend()
        assert [each.get_text() for each in legend.get_texts()] == [words]


def test_cycles_and_sites_of_a_cohort_can_be_told_apart():
    loops = [Loop(k, (DEPTH, DEPTH), (DEPTH[:0], DEPTH[:0])) for k in range(1, 13)]
    rows = [
        {"location": f"s{k:02d}", "measured_mm_per_mpa": 10.0 + k, "predicted_mm_per_mpa": 11.0}
        for k in range(20)
    ]
    for axes, first in ((cycles(loops).axes[0], 0), (compliance(rows).axes[0], 1)):
        looks = [(each.get_color(), each.get_marker()) for each in axes.lines[first:]]
        assert len(looks) == len(set(looks)) >= 12


@pytest.mark.slow
def test_long_names_leave_room_for_the_parameters_of_a_study():
    names = [f"Patient-mit-sehr-langem-Namen-{k} (Ordner {k}) medial proximal" for k in range(12)]
    known = EstimateView(name="c", value=5.0, unit="kPa", low=4.0, high=7.0, flag="fixed")
    figure = drawn(study_figure([(name, {"c": known}) for name in names]))
    assert all(axes.bbox.width > 0.2 * figure.bbox.width for axes in figure.axes)
    labels = [each.get_window_extent() for each in figure.axes[0].get_yticklabels()]
    assert all(not one.overlaps(other) for one, other in pairwise(labels))
    assert [each.get_text() for axes in figure.axes for each in axes.texts] == ["not known", "not known"]


@pytest.mark.parametrize("ends", [(4.0, 7.0), (3.0, 40.0), (0.02, 2000.0)])
def test_numbers_on_logarithmic_axes_are_plain(ends):
    figure = Figure()
    axes = figure.subplots()
    axes.loglog(ends, ends)
    plain_log(axes.xaxis)
    drawn(figure)
    shown = [each.get_text() for each in axes.get_xticklabels()]
    assert len(shown) >= 2
    assert not any("times" in each or "^" in each for each in shown)
    assert not [each for each in axes.get_xticklabels(minor=True) if each.get_text()]


@pytest.mark.slow
def test_a_long_name_stands_at_its_own_site_of_a_cohort():
    names = [f"site {k}" for k in range(7)]
    names[2] = "Unterschenkel dorsal, handbreit unter dem Köpfchen"
    own = {"beyond_family": "", "geometric_mean": 4.0, "spread_factor": 1.3, "low": 3.0, "high": 5.0}
    keys = ("c_muscle_kpa", "c_fat_kpa", "m")
    values = {f"{key}{end}": 4.0 for key in keys for end in ("", "_low", "_high")}
    rows = [{"location": name, **values} for name in names]
    figure = drawn(distributions(rows, {name: {"population": dict.fromkeys(keys, own)} for name in names}))
    axes = figure.axes[-1]
    for k, label in enumerate(axes.get_xticklabels()):
        x = axes.transData.transform((k, 1.0))[0]
        box = label.get_window_extent()
        assert box.x0 < x < box.x1 + 0.03 * figure.bbox.width
        assert abs(box.x1 - x) < 0.5 * axes.bbox.width / len(names)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 3])
def test_words_beside_flat_speed_maps_do_not_touch(rows):
    lateral, depth = (each.ravel() for each in np.meshgrid(np.arange(-25.0, 26, 5), np.linspace(2, 6, rows)))
    own = SweMap(lateral, depth, 2.0 + 0.1 * depth)
    figure = drawn(speed_maps([LevelMaps(k, 2.0 * k, own, own) for k in range(3)]))
    words = [axes.yaxis.label.get_window_extent() for axes in figure.axes if "depth" in axes.get_ylabel()]
    assert len(words) == 3
    assert not any(one.overlaps(other) for one, other in pairwise(words))


def test_speed_maps_tell_the_side_to_which_lateral_grows():
    words = speed_maps(maps(2, measured=True), toward="left").get_supxlabel()
    assert "(+ is left)" in words
    assert "+" not in speed_maps(maps(2, measured=True)).get_supxlabel()


def test_force_before_contact_is_no_less_than_nothing_on_speed_maps():
    shown = [replace(each, force=each.force - 0.02) for each in maps(2, measured=True)]
    panels = {row[0] for row in figure_data(speed_maps(shown))}
    assert {"measured, level 0 (0.0 N)", "measured, level 1 (2.0 N)"} <= panels


def test_layers_of_a_single_level_are_seen():
    one = np.array([[1.5, 6.0]])
    left, right = layers_figure(np.array([4.0]), ("skin", "fat"), one, one, 0.2).axes
    bands = [each for each in left.collections if each.get_label().endswith("predicted")]
    for band, ends in zip(bands, ((0.0, 1.5), (1.5, 7.5)), strict=True):
        corners = band.get_paths()[0].vertices
        assert np.ptp(corners[:, 0]) == 1.0
        assert (corners[:, 1].min(), corners[:, 1].max()) == ends
    assert len({line.get_marker() for line in right.lines[:2]}) == 2


def test_table_of_speed_maps_tells_row_level_and_axes():
    panels = {row[:3] for row in figure_data(speed_maps(maps(2, measured=True)))}
    across = "lateral [mm], 0 under the probe's centre; depth 0 at its face"
    rows = (("measured", "measured"), ("predicted", "predicted"), ("difference", "predicted − measured"))
    assert panels == {
        (f"{row}, level {k} ({2 * k:.1f} N)", across, f"{words} depth [mm]")
        for row, words in rows
        for k in (0, 1)
    }
