"""What other boundaries of a fitted model change: force, and the parameters that would then fit."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.feb.settings import schedule
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.kept_solves import CheckSolver, checked_levels
from limbcli.fitting.laws import LAWS
from limbcli.fitting.model_checks import (
    BOUNDARIES,
    ChangedForces,
    boundary_modes,
    changed_forces,
    moved_parameters,
    write_boundary_check,
)
from limbcli.inference.prediction import Prediction, SolvedPoints
from limbcli.inference.two_step_fit import CurveMatch, ForceDepth
from limbcli.model import LimbModel
from limbcli.progress import Progress
from limbcli.site_model.indentation_model import indentation_model
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.fit import FitOptions, fit
from limbcli.stages.fit_joint import fit_joint
from tests.stages import block_case as block

BOTH = {0: "f_kappa", 1: "m"}
DEPTHS = np.array([1.0, 2.0, 3.0])
CUT_FREE, FAR_SIDE_HELD = BOUNDARIES


def cut_from_a_limb() -> LimbModel:
    """The block of tissue, cut at its sides, on bone at its base."""
    model = block.block_model()
    points, fixed = model.mesh.points, model.mesh.node_sets["fixed"]
    bone = fixed[points[fixed, 2] < -15.999]
    sets = {**model.mesh.node_sets, "bone": bone, "cut": np.setdiff1d(fixed, bone)}
    return replace(model, mesh=replace(model.mesh, node_sets=sets))


def cut_block() -> LimbModel:
    return indentation_model(cut_from_a_limb(), schedule(list(DEPTHS)), c=0.008, f_kappa=100.0, m=3.0)


def solved(model: LimbModel) -> np.ndarray:
    with ReferenceSession(model, threads=1) as session:
        return session.solve().must_points.forces


def writer() -> SimpleNamespace:
    return SimpleNamespace(data={}, summary=[], warnings=[])


def test_a_freed_cut_lowers_the_force_and_a_boundary_that_is_not_there_is_left_out():
    model, written = cut_block(), writer()
    forces = solved(model)
    changed = changed_forces(model, forces, lambda each: CheckSolver().forces(each.of(model)))
    write_boundary_check(changed, DEPTHS, written)
    found = written.data["boundary_check"]
    change = found["cut_free"]["force_change_fraction"]
    assert change == pytest.approx(solved(CUT_FREE.of(model)) / forces - 1.0, abs=1e-3)
    assert np.all(change < -0.005)
    assert np.all(np.diff(change) < 0), "the more, the deeper"
    assert found["far_side_held"] == {"not_evaluated": "the model has no such boundary"}
    (line,) = written.summary
    assert line.startswith("if the cut plane were free, the force would be")
    assert line.endswith("% lower at 3.0 mm")
    assert not written.warnings


def test_levels_solved_before_lead_to_the_same_forces():
    """Their displacements are not zero where another boundary holds the tissue."""
    model = cut_block()
    sides = replace(model, supports=CUT_FREE.of(model).supports, mesh=CUT_FREE.of(model).mesh)
    with ReferenceSession(sides, threads=1) as session:
        session.solve()
        led = CheckSolver(like=session).forces(model)
        levels = session.kept_levels
    assert led == pytest.approx(solved(model), rel=1e-3)
    seen: list[int] = []

    def listen(kind, facts):
        if kind == "newton" and facts["iteration"]:
            seen.append(facts["step"])

    from_levels = CheckSolver(levels=levels).forces(model)
    assert from_levels == pytest.approx(led, rel=1e-3)
    CheckSolver(levels=levels, progress=Progress(listen)).forces(sides)
    assert not seen, "the levels are used: without a change they are in equilibrium"


def test_of_many_levels_some_are_solved():
    depths = [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    model = indentation_model(cut_from_a_limb(), schedule(depths), c=0.008, f_kappa=100.0, m=3.0)
    free, seen, rows = CUT_FREE.of(model), set(), checked_levels(model)

    def listen(kind, facts):
        if kind == "newton":
            seen.add(facts["n_steps"])

    found = CheckSolver(rows=rows, progress=Progress(listen)).forces(free)
    assert seen == {3}
    assert found == pytest.approx(solved(free)[rows], rel=1e-3)


def test_what_cannot_be_solved_is_said_and_the_other_boundary_is_still_tried():
    model, written = cut_block(), writer()

    def again(_):
        raise SolveError("a fold of the skin", where="level 2", fix="none")

    write_boundary_check(changed_forces(model, np.ones(3), again), DEPTHS, written, site="p2")
    assert written.data["boundary_check"]["p2"]["cut_free"] == {"not_evaluated": "a fold of the skin"}
    assert "far_side_held" in written.data["boundary_check"]["p2"]
    (line,) = written.warnings
    assert line.startswith("p2: the force if the cut plane were free was not evaluated: a fold of the skin; ")
    assert line.endswith("; no interval allows for it")


def test_half_of_what_a_boundary_changes_is_one_standard_deviation():
    error = SolveError("a fold of the skin", where="level 2", fix="none")
    changed = [
        ChangedForces(CUT_FREE, np.array([0.81, 0.64])), ChangedForces(FAR_SIDE_HELD, error=error),
        ChangedForces(FAR_SIDE_HELD),
    ]  # fmt: skip
    modes = boundary_modes(changed, DEPTHS, np.array([1.0, 1.5, 3.0]))
    assert modes == pytest.approx(np.log([[0.9, np.sqrt(0.9 * 0.8), 0.8]])), "the last one goes on"
    assert boundary_modes(changed[1:], DEPTHS, DEPTHS).shape == (0, 3)


@pytest.mark.slow
def test_a_limb_that_gives_way_beyond_the_cut_lies_within_the_intervals(tmp_path):
    """Half-way between held and free; f_kappa makes up for it, farther than noise and mesh alone allow."""
    model = indentation_model(cut_from_a_limb(), schedule(list(DEPTHS)), c=0.008, f_kappa=40.0, m=3.0)
    forces = np.sqrt(solved(model) * solved(CUT_FREE.of(model)))
    out = tmp_path / "out"
    case = block.make_case(tmp_path / "case", out, DEPTHS, forces, c=0.008, model=cut_from_a_limb())
    options = FitOptions(c_deviation=0.002, gain_deviation=0.002, max_interval_solves=3, contact_check=False)
    result = fit(case, out=out, solver="reference", options=options)[0]
    (low, high), (_, highest) = (result.data[key]["f_kappa"] for key in ("interval_95_noise", "interval_95"))
    assert low < result.data["f_kappa"] < high < 40.0 < highest
    assert result.data["standard_error"]["f_kappa"] > 2.0 * (high - low) / 3.92
    (line,) = [each for each in result.summary if "with noise and mesh alone" in each]
    assert f"to {high:.3g} for f_kappa" in line


@pytest.mark.slow
def test_a_joint_fit_counts_its_boundaries_as_an_uncertain_gain_of_the_force(tmp_path):
    model = indentation_model(cut_from_a_limb(), schedule(list(DEPTHS)), c=0.008, f_kappa=20.0, m=5.0)
    curve = LawCurve(model, LAWS["ogden"], c=0.008, density_kg_per_m3=1000.0)
    forces, speeds = np.split(curve(np.array([20.0, 5.0])).values, 2)
    curve.close()
    case = block.make_case(
        tmp_path / "case", tmp_path / "out", DEPTHS, forces, c=0.008, speeds=speeds, model=cut_from_a_limb()
    )
    usual, widths = FitOptions(contact_check=False, max_interval_solves=2, gain_deviation=0.01), []
    for checked in (False, True):
        options = replace(usual, boundary_check=checked)
        data = fit_joint(case, out=tmp_path / "out", options=options).data
        assert data["c_kpa"] == pytest.approx(8.0, rel=0.01)
        low, high = data["interval_95"]["f_kappa"]
        widths.append(high / low)
        assert ("boundary_check" in data) is checked
    change = np.array(data["boundary_check"]["p1"]["cut_free"]["force_change_fraction"])
    share = float(np.sqrt(np.mean((0.5 * np.log1p(change)) ** 2)))
    assert data["gain_deviations"] == {"p1": pytest.approx(np.hypot(0.01, share))}
    assert share > 0.05
    assert widths[1] > 2.0 * widths[0], "f_kappa makes up for it"


def law(theta: np.ndarray, wrt=()) -> Prediction:
    """Forces of a curve that f_kappa scales and m bends."""
    f_kappa, m = theta
    values = f_kappa**0.3 * np.expm1(0.2 * m * DEPTHS) / m
    by_m = f_kappa**0.3 * (0.2 * DEPTHS * np.exp(0.2 * m * DEPTHS) / m - np.expm1(0.2 * m * DEPTHS) / m**2)
    return Prediction(values, np.stack([0.3 * values / f_kappa, by_m], axis=1))


def test_the_parameters_that_would_fit_are_those_by_which_the_changed_model_gives_the_same_curve():
    theta, nearby = np.array([80.0, 3.0]), np.array([84.0, 2.95])
    curve = SolvedPoints(law)
    data = ForceDepth(curve(theta).values, DEPTHS, 0.1, 0.1)
    ratio = curve(theta).values / curve(nearby).values  # of a model that needs `nearby` for that curve
    found = moved_parameters(CurveMatch(curve, DEPTHS, data), theta, BOTH, DEPTHS, ratio)
    assert found == pytest.approx({"f_kappa": 84.0, "m": 2.95}, rel=5e-3)
    assert moved_parameters(CurveMatch(curve, DEPTHS, data), theta, BOTH, DEPTHS, 0.3 * ratio) == {}
    assert moved_parameters(CurveMatch(curve, DEPTHS, data), theta, {}, DEPTHS, ratio) == {}, (
        "none is identified"
    )
    (name,) = moved_parameters(CurveMatch(curve, DEPTHS, data), theta, {1: "m"}, DEPTHS, ratio)
    assert name == "m"
    two = moved_parameters(CurveMatch(curve, DEPTHS, data), theta, BOTH, DEPTHS, ratio[:2])
    assert two == pytest.approx(found, rel=2e-2), "from the levels that were reached"
