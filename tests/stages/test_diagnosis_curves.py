"""Curves of which the solver reaches a part only, and simulations kept on disk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.diagnosis.curves import site_solver
from limbcli.diagnosis.curves.curve_plan import Reach, SiteWork, Solving, some_solved
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.curves.site_solver import SiteSolver
from limbcli.diagnosis.data.windows import Windows
from limbcli.diagnosis.forward_model.changes import Changes
from limbcli.diagnosis.forward_model.surrogate import AtPoints, SiteCurves
from limbcli.diagnosis.mesh_error.mesh_correction import Penetration
from limbcli.effects import effect
from limbcli.effects.curves import Curves, depth_at, force_at
from limbcli.errors import SolveError
from limbcli.feb.settings import robust_step, schedule
from limbcli.fem.equilibrium.solve_times import step_times
from limbcli.progress import SILENT, Progress
from limbcli.site_model.indentation_model import fewer_steps
from limbcli.solvers.session_options import Budget, BudgetSpent
from tests.stages import block_case

ALONE = Solving(threads=1)
DEPTHS = (1.0, 2.0, 3.0, 4.0)
TILTED = ((effect("tilt"), {"tilt_about_short_axis_deg": 5.0, "tilt_about_long_axis_deg": 0.0}),)
THICKER = ((effect("thickness"), {"thickness_change": 0.1}),)
SOFTER = {
    size: ((effect("nonlinearity"), {"weight_q": size, "second_pair_share": 0.0}),) for size in (0.30, 0.33)
}  # a fit's sizes, one after the other
# where the first order is taken, and a fit's beside it
TENSED = {size: ((effect("contraction"), {"active_stress_per_c": size}),) for size in (0.30, 0.33)}


@pytest.fixture(scope="module")
def block():
    return block_case.block_model(counts=(4, 2, 2))


class Stops:
    """A solver that gets no further than so many levels."""

    def __init__(self, after: int):
        self.after = after

    def __call__(self, kind, facts):
        if kind == "newton" and facts["step"] > self.after:
            raise SolveError("as far as it goes", where="level", fix="none")


def whole(block, m, ingredients=()):
    simulations = SiteSimulations(block, DEPTHS, c=0.006, solving=Solving(tolerance=1e-6, threads=1))
    curves = simulations.curves(m, ingredients)
    simulations.close()
    assert simulations.in_part == {}
    return curves


@pytest.mark.parametrize(
    ("m", "ingredients", "words", "within"),
    [(4.0, (), "no effect", 0.01), (8.0, THICKER, "thickness", 0.002)],
)
def test_curves_that_stop_short_go_on_beside_others(block, tmp_path, m, ingredients, words, within):
    stops = Stops(9)
    simulations = SiteSimulations(
        block,
        DEPTHS,
        c=0.006,
        solving=Solving(tolerance=1e-6, threads=1),
        progress=Progress(stops),
        keep=tmp_path,
    )
    simulations.curves(8.0)
    stops.after = 3
    found, expected = simulations.curves(m, ingredients), whole(block, m, ingredients)
    simulations.close()
    assert simulations.in_part == {f"{words}, m {m:g}": 3.0}
    np.testing.assert_allclose(found.depth, expected.depth)
    np.testing.assert_allclose(found.force[:-1], expected.force[:-1], rtol=1e-4)
    assert found.force[-1] == pytest.approx(expected.force[-1], rel=within)
    again = SiteSimulations(block, DEPTHS, c=0.006, keep=tmp_path)
    assert again.curves(m, ingredients).force == pytest.approx(found.force)
    assert again.n_solves == 0
    assert again.in_part == simulations.in_part


def test_a_model_with_effects_is_solved_at_few_depths(block):
    """What they change is smooth: the other depths follow, with less work."""
    depths = [4.0 / 6 * each for each in (0.5, 1, 2, 3, 4, 5, 6)]
    few, every = (SiteSimulations(block, depths, c=0.006, solving=ALONE) for _ in range(2))
    every.few = every.depths
    spent = {}
    for each in (few, every):
        each.curves(8.0)
        before = each.work.total
        each.curves(8.0, THICKER)
        spent[each] = each.work.total - before
        each.close()
    found, expected = few.curves(8.0, THICKER), every.curves(8.0, THICKER)
    np.testing.assert_allclose(few.few, [depths[k] for k in (1, 3, 5, 6)])
    np.testing.assert_allclose(found.depth, expected.depth)
    np.testing.assert_allclose(found.force, expected.force, rtol=0.003, atol=0.002 * expected.force[-1])
    assert abs(found.force[-1] / few.curves(8.0).force[-1] - 1.0) > 0.02
    shown = np.isfinite(found.log_speed) & np.isfinite(expected.log_speed)
    assert shown.sum() > 0.9 * np.isfinite(expected.log_speed).sum()
    assert np.std(found.log_speed[shown] - expected.log_speed[shown]) < 0.006  # single parts up to 0.04
    assert spent[few] < 0.8 * spent[every]


def test_what_curves_go_on_beside_is_no_work_of_theirs(block, tmp_path, monkeypatch):
    """Nor when it is taken up again, where they are kept and it is not asked for."""
    solve, stops = SiteSolver.solve, Stops(9)

    def stopped(self, m, ingredients, depths):
        stops.after = 3 if ingredients else 9
        return solve(self, m, ingredients, depths)

    monkeypatch.setattr(SiteSolver, "solve", stopped)
    solving = Solving(tolerance=1e-6, threads=1)
    simulations = SiteSimulations(
        block, DEPTHS, c=0.006, solving=solving, progress=Progress(stops), keep=tmp_path
    )
    again = SiteSimulations(block, DEPTHS, c=0.006, keep=tmp_path)
    for each in (simulations, again):
        each.curves(8.0)
        each.curves(5.0, THICKER)
    simulations.close()
    assert simulations.in_part == {"thickness, m 5": 3.0}
    assert (simulations.n_solves, again.n_solves) == (3, 0)
    assert (again.work.total, again.work.usual) == (simulations.work.total, simulations.work.usual)


def test_what_stops_far_short_has_no_curves(block):
    simulations = SiteSimulations(block, DEPTHS, c=0.006, solving=ALONE, progress=Progress(Stops(2)))
    with pytest.raises(SolveError, match="as far as it goes"):
        simulations.curves(5.0)
    simulations.close()
    fits = SiteSimulations(
        block, DEPTHS, c=0.006, solving=ALONE, progress=Progress(Stops(2)), reach=Reach(needed=2.0)
    )
    assert len(fits.curves(5.0).depth) == len(DEPTHS) + 1  # the deeper levels are tried, not needed
    assert fits.in_part == {}
    fits.close()


def test_levels_on_another_mesh_lead_with_less_work_to_the_same(block, tmp_path):
    fine, few = block_case.block_model(counts=(6, 3, 3)), (4.0,)
    simulations, again = (
        SiteSimulations(block, DEPTHS, c=0.006, keep=tmp_path, solving=ALONE) for _ in range(2)
    )
    alone = SiteSimulations(fine, few, c=0.006, solving=Solving(tolerance=1e-6, threads=1))
    led, resumed = (
        SiteSimulations(fine, few, c=0.006, solving=Solving(tolerance=1e-6, threads=1, beside=each))
        for each in (simulations, again)
    )
    expected, found, taken_up = (each.curves(4.0).force for each in (alone, led, resumed))
    for each in (simulations, again, alone, led, resumed):
        each.close()
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert led.work.total < 0.8 * alone.work.total
    assert again.n_solves == 0
    np.testing.assert_array_equal(taken_up, found)


def test_a_diagnosis_taken_up_again_allows_candidates_as_much_work_as_before(block, tmp_path):
    simulations, again = (
        SiteSimulations(block, [1.0, 2.0], c=0.006, keep=tmp_path, solving=ALONE) for _ in range(2)
    )
    first, second = simulations.curves(3.0), again.curves(3.0)
    assert (simulations.n_solves, again.n_solves) == (1, 0)
    assert second.force == pytest.approx(first.force)
    assert again.work.usual == simulations.work.usual
    assert simulations.work.usual[0] > 0
    assert again.work.total == simulations.work.total > 0
    kept = again.kinematics(3.0).gradient
    assert again.n_solves == 0
    assert kept == pytest.approx(simulations.kinematics(3.0).gradient, abs=1e-6)
    simulations.close()


@pytest.mark.slow
def test_a_diagnosis_taken_up_again_gives_the_very_same_numbers(block, tmp_path):
    """Wherever it was stopped: else what was close to a threshold is answered in another way."""
    requested = [(8.0, ()), (4.0, ()), (4.0, THICKER), (5.0, ()), (5.0, SOFTER[0.30]), (5.1, SOFTER[0.33])]

    def solved(folder, n_before: int):
        """Curves and kept deformation by one set of simulations, or by two with a stop in between."""
        for some in (requested[:n_before], requested):
            simulations = SiteSimulations(block, DEPTHS, c=0.006, solving=ALONE, keep=folder)
            curves = [simulations.curves(m, ingredients) for m, ingredients in some]
            gradient = simulations.kinematics(4.0).gradient if some is requested else None
            simulations.close()
        return curves, gradient, simulations.work.total

    whole_curves, whole_gradient, whole_work = solved(tmp_path / "whole", 0)
    for n_before in (1, 3, 5):
        curves, gradient, work = solved(tmp_path / str(n_before), n_before)
        for found, expected in zip(curves, whole_curves, strict=True):
            np.testing.assert_array_equal(found.force, expected.force)
            np.testing.assert_array_equal(found.log_speed, expected.log_speed)
        np.testing.assert_array_equal(gradient, whole_gradient)
        assert work == whole_work


@pytest.mark.parametrize(("before", "again"), [(SOFTER[0.30], SOFTER[0.33]), (TENSED[0.30], TENSED[0.33])])
def test_an_explanation_that_is_solved_again_is_led_by_its_levels_before(block, before, again):
    """Refits on the model as it stands ask for the same effects at sizes near by, or near those of the first
    order."""

    def work_and_force(*several):
        simulations = SiteSimulations(block, DEPTHS, c=0.006, solving=Solving(tolerance=1e-6, threads=1))
        for m in (8.0, 4.0):
            simulations.curves(m)
        for ingredients in several:
            before = simulations.work.total
            force = simulations.curves(5.0, ingredients).force
        simulations.close()
        return simulations.work.total - before, force

    alone, expected = work_and_force(again)
    led, force = work_and_force(before, again)
    np.testing.assert_allclose(force, expected, rtol=1e-5)
    assert led < 0.95 * alone


@pytest.mark.parametrize("spoil", [Path.unlink, lambda path: path.write_bytes(b"PK\x03\x04 cut off")])
def test_a_kept_deformation_whose_file_is_gone_is_solved_again(block, tmp_path, spoil):
    simulations, again = (
        SiteSimulations(block, [1.0, 2.0], c=0.006, keep=tmp_path, solving=ALONE) for _ in range(2)
    )
    simulations.curves(3.0)
    for path in tmp_path.glob("*-nodes.npz"):
        spoil(path)
    assert again.kinematics(3.0).gradient == pytest.approx(simulations.kinematics(3.0).gradient, abs=1e-6)
    assert again.n_solves == 1
    simulations.close()
    again.close()


@pytest.mark.parametrize(
    ("name", "other"), [("_READING", site_solver._READING + 1), ("__version__", "0.0.0")]
)
def test_curves_that_were_read_or_solved_otherwise_are_solved_again(
    block, tmp_path, monkeypatch, name, other
):
    def n_kept() -> int:
        SiteSimulations(block, [1.0, 2.0], c=0.006, keep=tmp_path, solving=ALONE).curves(8.0)
        return len(list(tmp_path.glob("*-levels.npz")))

    assert [n_kept(), n_kept()] == [1, 1]
    monkeypatch.setattr(site_solver, name, other)
    assert n_kept() == 2


def test_curves_are_of_the_tissues_density(block, tmp_path):
    """Speeds are kept, and go with the root of the modulus over the density."""

    def speeds(density: float):
        simulations = SiteSimulations(
            block, [1.0, 2.0], c=0.006, density_kg_per_m3=density, keep=tmp_path, solving=ALONE
        )
        found = simulations.curves(4.0).log_speed
        simulations.close()
        return found

    at_1000, at_1300 = speeds(1000.0), speeds(1300.0)
    assert at_1300 - at_1000 == pytest.approx(
        np.where(np.isfinite(at_1000), -0.5 * np.log(1.3), np.nan), nan_ok=True
    )


def test_a_turned_probes_curves_go_on_at_the_depths_that_were_asked_for(block):
    """The turned face is lifted, so that depth counts from its first touch; that is in them already."""
    stops = Stops(9)
    simulations = SiteSimulations(
        block, DEPTHS, c=0.006, solving=Solving(tolerance=1e-6, threads=1), progress=Progress(stops)
    )
    simulations.curves(8.0)
    stops.after = 3
    found, expected = simulations.curves(8.0, TILTED), whole(block, 8.0, TILTED)
    simulations.close()
    assert simulations.in_part == {"tilt, m 8": 3.0}
    np.testing.assert_allclose(found.depth, [0.0, *DEPTHS])
    assert found.force[-1] == pytest.approx(expected.force[-1], rel=0.15)


@pytest.mark.parametrize(
    ("name", "theta"), [("contact", {"penalty_factor": 0.1}), ("friction", {"friction_coefficient": 0.5})]
)
def test_an_effect_of_any_name_may_change_contact(block, name, theta):
    """It is what an effect makes of a model that tells how it is solved, not what it is called."""
    known = effect(name)
    mine = replace(known, name="my-" + name, kind="tissue")
    simulations = SiteSimulations(block, [1.0, 2.0], c=0.006, solving=Solving(tolerance=1e-5, threads=1))
    plain, expected, found = (
        simulations.curves(4.0, each) for each in ((), ((known, theta),), ((mine, theta),))
    )
    simulations.close()
    assert found.force == pytest.approx(expected.force, rel=1e-3)
    assert abs(np.log(found.force[-1] / plain.force[-1])) > 0.05


def iterate(budget: Budget, n: int) -> None:
    for _ in range(n):
        budget.charge(step=1, n_steps=8, krylov=20, factorisations=0)


def test_with_friction_a_model_is_solved_in_two_steps_alike_from_level_to_level(block):
    plan = schedule([1.0, 2.0, 3.0, 4.0], start=0.05)
    (step,) = fewer_steps(replace(block, steps=(robust_step(plan, "tet10"),)), 8).steps
    times = step_times(step, every=True)
    np.testing.assert_allclose(times, np.arange(1, 9) * 0.05)
    assert step_times(step) == list(plan.times)


@pytest.mark.parametrize(
    ("options", "iterations"), [({}, 200), ({"fitted": True}, 300), ({"has_friction": True}, 600)]
)
def test_a_candidate_is_stopped_after_several_times_the_usual_work(options, iterations):
    budget = SiteWork(usual=[2000, 4000]).of_candidate(**options)
    with pytest.raises(BudgetSpent):
        iterate(budget, 10_000)
    assert budget.spent == 30 * (iterations + 1)


@pytest.mark.parametrize(("n_cells", "iterations"), [(1000, 200), (10_000, 83), (100_000, 50)])
def test_a_candidate_of_a_large_model_is_stopped_sooner(n_cells, iterations):
    """After 25 million products times cells, but never before 1500 products."""
    budget = SiteWork(n_cells=n_cells, usual=[2000, 4000]).of_candidate()
    with pytest.raises(BudgetSpent):
        iterate(budget, 10_000)
    assert budget.spent == 30 * (iterations + 1)


@pytest.mark.parametrize(
    ("name", "theta", "fitted"),
    [
        ("thickness", {"thickness_change": 0.05}, False),
        ("thickness", {"thickness_change": 0.06}, True),
        ("contraction", {"active_stress_per_c": 0.3}, False),
        ("contraction", {"active_stress_per_c": 0.4}, True),
        ("anisotropy", {"fibre_shear_per_c": 0.0, "fibre_exponent": 3.0}, False),
    ],
)
def test_a_size_that_was_fitted_is_told_from_a_sensitivitys(block, monkeypatch, name, theta, fitted):
    """By how much work the solve may take."""
    simulations, seen = SiteSimulations(block, DEPTHS, c=0.006, solving=ALONE), {}

    def of_candidate(**facts):
        seen.update(facts)
        raise SolveError("not in this test", where="here", fix="none")

    monkeypatch.setattr(simulations.work, "of_candidate", of_candidate)
    with pytest.raises(SolveError):
        simulations.curves(5.0, ((effect(name), {**effect(name).null, **theta}),))
    assert seen["fitted"] is fitted


def test_all_the_work_of_a_diagnosis_has_a_limit():
    work = SiteWork(usual=[2000, 4000], total=30 * 3000)
    assert not work.spent
    work.total += 1
    assert work.spent
    large = SiteWork(n_cells=10_000, usual=[2000, 4000], total=9_999)
    assert not large.spent
    large.total += 2
    assert large.spent


@pytest.mark.parametrize(
    ("reach", "solved"), [((10.0, 5.0, 2.0), [2.0, 5.0, 10.0]), ((5.0, 2.0), [2.0, 5.0])]
)
def test_a_law_that_fails_is_left_out_unless_all_do(reach, solved):
    class Book:
        c = 0.006

        def __init__(self):
            self.requested = []

        def curves(self, m, ingredients=()):
            self.requested.append(m)
            if m not in reach:
                raise SolveError(f"not at {m:g}", where="level", fix="none")
            return None

    site = SiteCurves(None, Book(), {})
    site.solve_nodes((2.0, 10.0, 5.0))
    assert sorted(site.nodes) == solved
    assert site.simulations.requested[:3] == [10.0, 5.0, 2.0]
    site.solve_nodes([7.0])
    assert sorted(site.nodes) == solved
    with pytest.raises(SolveError, match="not at 7"):
        SiteCurves(None, Book(), {}).solve_nodes((7.0,))


def test_what_fails_for_some_is_left_out_and_for_all_is_an_error():
    def of(m: float) -> float:
        if m > 2.0:
            raise SolveError(f"not at {m:g}", where="level", fix="none")
        return 10.0 * m

    assert some_solved(of, (1.0, 3.0, 2.0)) == [10.0, 20.0]
    assert some_solved(of, ()) == []
    with pytest.raises(SolveError, match="not at 4"):
        some_solved(of, (3.0, 4.0))


class ThicknessBook:
    """Changes of thickness take 1 % a per cent from all speeds, and 40 % from one part of the new mesh."""

    c, spent, model = 0.006, False, None
    windows = Windows(-20.0, 20.0, 2.0, 26.0, across=10, down=6)

    def curves(self, m, ingredients=()):
        thinner = sum(theta["thickness_change"] for _, theta in ingredients)
        log_speed = np.full((3, 61), 0.7 - thinner)
        if thinner:
            log_speed[2, 41] -= 0.4
        force = (np.arange(3.0) + 1.0) * np.exp(-thinner)
        return Curves(np.arange(3.0), force, log_speed, self.windows.depths, 40.0)


def test_an_effect_that_moves_the_mesh_changes_parts_that_are_side_by_side_alike():
    simulations, thickness = ThicknessBook(), effect("thickness")
    change = Changes(simulations, progress=SILENT).of(thickness, {})({"thickness_change": -0.1})
    assert change[:, 1:] == pytest.approx(np.full((3, 61), 0.1))
    site = SiteCurves(None, simulations, {"thickness": thickness})
    site.solve_nodes((4.0, 8.0))
    site.changes.m = 4.0
    theta, thicker = {"thickness_change": -0.1}, AtPoints(("thickness",), ({},))
    site.repair(4.0, thicker, theta)
    assert site.curves(simulations.c, 4.0, thicker, theta).log_speed == pytest.approx(
        np.full((3, 61), 0.8), abs=1e-9
    )


class TiltBook:
    """Either edge that touches first takes from the force; which one it is matters less."""

    c, spent, model = 0.006, False, None
    windows = Windows(-20.0, 20.0, 2.0, 26.0, across=10, down=6)

    def __init__(self, fails: float | None = None):
        self.fails = fails

    def curves(self, m, ingredients=()):
        angle = sum(theta["tilt_about_long_axis_deg"] for _, theta in ingredients)
        if angle == self.fails:
            raise SolveError("not at that one", where="level", fix="none")
        force = (np.arange(3.0) + 1.0) * np.exp(-0.008 * abs(angle) - 0.003 * angle)
        return Curves(np.arange(3.0), force, np.full((3, 61), 0.7 + 0.002 * angle), self.windows.depths, 40.0)


@pytest.mark.parametrize("angle", [-10.0, -5.0, 5.0, 10.0])
def test_a_probe_tilted_the_other_way_is_soft_at_first_touch_too(angle):
    tilt = effect("tilt")
    change = Changes(TiltBook(), progress=SILENT).of(tilt, {})
    found = change({**tilt.null, "tilt_about_long_axis_deg": angle})
    assert found[1:, 0] == pytest.approx(-0.008 * abs(angle) - 0.003 * angle, abs=0.011)
    assert found[:, 1:] == pytest.approx(0.002 * angle)
    ends = [change({**tilt.null, "tilt_about_long_axis_deg": each})[2, 0] for each in (-0.1, 0.1)]
    assert (ends[1] - ends[0]) / 0.2 == pytest.approx(-0.003), "the slope at null is that of the two sides"


def test_a_tilt_without_an_answer_on_its_other_side_goes_by_the_one():
    tilt = effect("tilt")
    change = Changes(TiltBook(fails=-5.0), progress=SILENT).of(tilt, {})
    found = change({**tilt.null, "tilt_about_long_axis_deg": 10.0})
    assert found[1:, 0] == pytest.approx(-0.11)


def test_a_trial_far_beyond_what_an_effect_can_be_still_gives_numbers():
    simulations, thickness = ThicknessBook(), effect("thickness")
    site = SiteCurves(
        None, simulations, {"thickness": thickness}, penetration=Penetration(np.r_[0.0, 1.0], np.r_[0.0, 0.1])
    )
    site.solve_nodes((4.0, 8.0))
    site.changes.m = 4.0
    for change in (-1e4, 1e4):
        found = site.curves(simulations.c, 4.0, AtPoints(("thickness",), ({},)), {"thickness_change": change})
        assert np.isfinite(found.log_speed).all()
        assert np.isfinite(force_at(found, np.array([0.5, 5.0]))).all()


def test_depth_at_a_force_of_a_curve_that_is_level_but_for_rounding():
    """Two forces 1e-16 apart have one logarithm, and a slope between them would be infinite."""
    force = np.array([0.0, 5.0, 500.0, np.nextafter(500.0, 501.0), 900.0])
    nothing = np.zeros((5, 1))
    found = depth_at(Curves(np.array([0.0, 2.0, 4.0, 5.0, 6.0]), force, nothing, nothing), force[1:])
    assert np.log(force[2]) == np.log(force[3])
    assert found == pytest.approx(np.array([2.0, 4.0, 4.0, 6.0]), rel=1e-9)
