"""Standard errors of fit.json, against the scatter of repeated fits on the cheap limb; curves.csv."""

import csv
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.fitting import joint_picture
from limbcli.fitting import result as fit_result
from limbcli.fitting.result import summarise, write_agreement, write_curves
from limbcli.fitting.table import Identified, step_agreement, step_table, total_covariance
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.profile import Profile
from limbcli.inference.profile_intervals import Stiffness
from limbcli.inference.two_step_fit import CurveMatch, ForceDepth, two_step
from limbcli.results import open_stage, read_result
from tests.loading import module_at

C, KNOTS = 0.008, np.linspace(1.0, 11.0, 11)


@pytest.mark.slow
@pytest.mark.parametrize("larger", [1.0, 4.0])
def test_a_standard_error_is_the_scatter_of_fits_also_where_noise_is_larger_than_stated(larger):
    """Of m alone, which these data tell; 14 fits tell a deviation to a fifth."""
    limb = module_at(Path(__file__).parents[1] / "inference" / "simulated.py")
    rng, found, stated = np.random.default_rng(7), [], []
    memory = SolvedPoints(limb.curve(KNOTS, C, "tet4"))
    for _ in range(14):
        force = limb.force(KNOTS, C, 50.0, 5.0, "tet4") + larger * 0.1 * rng.standard_normal(len(KNOTS))
        data = ForceDepth(force, KNOTS, 0.1, 0.0)
        steps = two_step(CurveMatch(memory, KNOTS, data))
        known = [Stiffness(C, 0.0)] * 2
        whole = Identified(memory, KNOTS, data, known, "", steps[0].theta, steps, None, 0.0)
        found.append(np.log(steps[-1].theta[1]))
        stated.append(np.sqrt(total_covariance(whole, steps[-1])[2, 2]))
    assert np.median(stated) == pytest.approx(np.std(found, ddof=1), rel=0.5)


def found_of(depth, force, gains=(0.0, 0.0)):
    """The cheap limb's fit to these levels."""
    known = [Stiffness(C, 0.1, each) for each in gains]
    limb = module_at(Path(__file__).parents[1] / "inference" / "simulated.py")
    knots = np.unique(depth[depth > 0.0])
    memory = SolvedPoints(limb.curve(knots, C, "tet4"))
    data = ForceDepth(force, depth, 0.1, 0.1)
    steps = two_step(CurveMatch(memory, knots, data))
    start = np.array([100.0, 2.0])
    return Identified(memory, knots, data, known, "", start, steps, None, 0.0)


def test_curves_hold_every_level_also_two_of_one_depth_and_one_before_touch(tmp_path):
    depth = np.array([0.0, -0.1, 2.0, 4.0, 6.0, 6.0, 8.0])
    force = np.array([0.0, 0.4, 3.9, 8.6, 14.6, 15.2, 23.1])
    found = found_of(depth, force)
    write_curves(found, tmp_path / "curves.csv")
    with (tmp_path / "curves.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    levels = [(float(r["depth_mm"]), float(r["measured_n"]), r["ogden_n"]) for r in rows if r["measured_n"]]
    assert [each[:2] for each in levels] == sorted(zip(depth, force, strict=True))
    assert levels[0][2] == levels[1][2] == "0"
    assert levels[-3][2] == levels[-2][2]
    assert len(rows) > 100


def test_the_numerical_error_is_that_of_each_step():
    levels = np.array([0.0, 3.0, 6.0, 9.0]), np.array([0.0, 6.2, 14.6, 28.0])
    found, same = (found_of(*levels, gains=gains) for gains in ((0.9, 0.1), (0.1, 0.1)))
    first, last = (found.gain_of(each) for each in found.steps)
    assert (first, last) == (0.9, 0.1)
    errors = [step_table(each, 0)["standard_error"]["f_kappa"] for each in (found, same)]
    assert errors[0] > 4 * errors[1]


def test_levels_at_first_touch_do_not_make_a_fit_look_better():
    depth, force = np.array([0.0, 3.0, 6.0, 9.0]), np.array([0.0, 7.2, 13.6, 28.0])
    once = found_of(depth, force)
    often = found_of(np.r_[0.0, 0.0, 0.0, depth], np.r_[0.0, 0.0, 0.0, force])
    ratios = [step_agreement(each, each.steps[-1]).times_noise for each in (once, often)]
    assert ratios[1] == pytest.approx(ratios[0], rel=1e-3)


def test_one_depth_read_three_times_does_not_identify_two_parameters():
    found = found_of(np.array([0.0, 6.0, 6.0, 6.0]), np.array([0.0, 14.7, 14.6, 14.8]))
    reported = step_table(found, 1)
    assert set(reported["flags"].values()) == {"fixed", "weak"}
    assert np.isnan([reported["standard_error"][name] for name in ("f_kappa", "m")]).all()


def test_profiles_are_shaded_as_far_as_the_intervals_that_are_told(tmp_path, monkeypatch):
    """Also where the fit, or a doubt of the geometry, lies beyond where the curve crosses its limit."""
    values = np.array([1.0, 2.0, 3.0])
    one = Profile("f_kappa", values, (values - 2.0) ** 2, values[:, None], 1.2, 9.0, False, False, values)
    reported = SimpleNamespace(threshold=0.25, profiles={"f_kappa": one, "m": replace(one, name="m")})
    depth = np.array([0.0, 3.0, 6.0, 9.0])
    found = replace(found_of(depth, np.array([0.0, 6.2, 14.6, 28.0])), intervals=(reported, reported))
    drawn = []
    monkeypatch.setattr(joint_picture, "save_figure", lambda figure, _: drawn.append(figure))
    monkeypatch.setattr(fit_result, "save_figure", lambda *_: None)
    site = SimpleNamespace(noise=SimpleNamespace(depth=0.1, force=0.1))
    fit_result.draw_fit(found, site, SimpleNamespace(file=lambda *_: tmp_path))
    for axes in drawn[0].axes:
        (shade,) = axes.patches
        assert (shade.get_x(), shade.get_width()) == pytest.approx((1.2, 9.0 - 1.2))


@pytest.mark.parametrize(
    ("factor", "measured", "state"),
    [(1.0, [2.3, 2.6, 3.0], "good"), (1.0, [2.3, 2.2, 2.1], "bad"), (1.0, [], "good"), (2.0, [], "bad")],
)
def test_the_verdict_stands_first_in_the_summary_and_in_the_result(tmp_path, factor, measured, state):
    """With the speeds predicted at the last three levels; force of a limb, or one that no m can follow."""
    depth = np.array([0.0, 2.0, 4.0, 6.0, 8.0, 10.0])
    limb = module_at(Path(__file__).parents[1] / "inference" / "simulated.py")
    force = np.r_[0.0, limb.force(depth[1:], C, 50.0, 5.0, "tet4")]
    force[1:] += [0.1, -0.2, 0.2, -0.3, 0.2]
    force[1:3] += 40.0 * (factor - 1.0)
    found = found_of(depth, force)
    with open_stage(tmp_path, "fit", subject="S1", site="p1") as writer:
        tables = {step.name: step_table(found, k) for k, step in enumerate(found.steps)}
        writer.data.update(
            steps=tables, element="tet10", n_iterations=3, n_solves=4, n_interval_solves=0,
            noise={"swe_level_fraction": 0.05},
            swe={"loaded_measured_m_per_s": measured,
                 "loaded_predicted_m_per_s": [2.35, 2.65, 2.95][: len(measured)]},
        )  # fmt: skip
        summarise(found, tables["ogden"], writer)
        write_agreement(found, writer)
    result = read_result(tmp_path, "fit", site="p1")
    told = result.data["agreement"]
    assert told["state"] == state, result.summary[:2]
    parts = [told[name] for name in ("tissue", "force", "speeds") if name in told]
    decides = next(each for each in parts if each["state"] == state)
    assert result.summary[0] == f"{state}: {decides['words']}"
    assert f"{told['force']['state']}: {told['force']['words']}" in result.summary
    assert ("speeds" in told) == bool(measured)
    assert result.data["misfit"]["poor"] == (told["force"]["state"] == "bad")
    assert len(told["force"]["counted_noise_n"]) == len(told["force"]["depths_mm"]) == 5
    assert min(told["force"]["counted_noise_n"]) > 0.1, "the depth's noise counts through the slope"
