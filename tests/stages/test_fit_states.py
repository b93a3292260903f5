"""The fit of several states: one law, a stretch a state, and the state of least stiffness, on a known
truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import limbcli
from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.inference.derived import derived_interval
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Residual
from limbcli.inference.profile import best_of
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult
from limbcli.site_model.site_states import states_of
from limbcli.stages.expect import compare
from limbcli.stages.fit import FitOptions, check_choice
from limbcli.stages.fit_states import fit_states, knots
from limbcli.stages.report import report
from tests.stages import block_case as block
from tests.stages import state_case

pytestmark = pytest.mark.slow

WAY, UNLOADED = state_case.WAY, f"unloaded_stretch_{state_case.WAY}"
OPTIONS = FitOptions(gain_deviation=0.03, max_interval_solves=1)


@pytest.fixture(scope="module")
def levels() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Depths and speeds of the three states, on a finer mesh than the fit's."""
    made = state_case.curve(counts=state_case.OTHER_MESH)
    found = {
        name: state_case.true_levels(made, [reported / state_case.UNLOADED])
        for name, reported in state_case.TOLD.items()
    }
    made.close()
    return found


@pytest.fixture(scope="module")
def case_and_out(levels, tmp_path_factory) -> tuple[Case, Path]:
    root = tmp_path_factory.mktemp("states")
    return state_case.make_case(root / "case", root / "out", state_case.noisy(levels, 7)), root / "out"


@pytest.fixture(scope="module")
def fitted(case_and_out) -> StageResult:
    case, out = case_and_out
    return fit_states(case, out=out, options=OPTIONS)[0]


def holds(interval, value: float) -> bool:
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)


@pytest.mark.drawn
@pytest.mark.slow
def test_three_states_give_back_the_law_and_where_it_is_unloaded(fitted):
    """Noise of 0.05 N, 0.05 mm and 3 % of the speeds; f_kappa also takes up the other mesh."""
    data = fitted.data
    truth = {"c_kpa": 6.0, "m": 6.0, UNLOADED: state_case.UNLOADED}
    for name, value in truth.items():
        assert holds(data["interval_95"][name], value), name
        assert data[name] == pytest.approx(value, rel=0.15)
        assert data["flags"][name] == "identified"
    for name, reported in state_case.TOLD.items():
        stretch = data["states"][name][f"stretch_{WAY}"]
        assert holds((stretch["low"], stretch["high"]), reported / state_case.UNLOADED)
        assert stretch["value"] == pytest.approx(reported / data[UNLOADED])
        assert data["states"][name]["stretch_along"] == {
            "told": 1.0, "value": 1.0, "low": 1.0, "high": 1.0, "known": True,
        }  # fmt: skip
    assert data["taken_as_unloaded"] == {"along": 1.0}


@pytest.mark.slow
def test_the_state_of_least_stiffness_has_an_interval(fitted):
    """Along the wave and at m = 6, v^2 is as l^6 + l^2 + l^-2, lowest where 3 l^8 + l^4 = 1."""
    found = fitted.data["least_stiffness"][WAY]
    lowest = state_case.UNLOADED * ((np.sqrt(13.0) - 1.0) / 6.0) ** 0.25
    assert found["told"]
    assert holds((found["low"], found["high"]), lowest)
    assert found["stretch"] == pytest.approx(lowest, rel=0.1)
    assert found["counted_from"] == "case"
    assert f"at a stretch of {found['stretch']:.2f}" in found["words"]
    assert lowest < 0.9 * state_case.UNLOADED  # not where the tissue is unloaded


@pytest.mark.slow
def test_page_files_and_python_hold_the_states(case_and_out, fitted):
    case, out = case_and_out
    text = report(case, out=out).path("page").read_text(encoding="utf-8")
    assert "In which state is the tissue least stiff" in text
    assert "the speed at rest is lowest at a stretch of" in text
    assert "0.720" in text or "0.72" in text
    assert {"states", "picture", "profiles", "feb_bent", "levels_bent"} <= set(fitted.files)
    model = read_feb(fitted.path("feb_bent"))
    reported = fitted.data["states"]["bent"][f"stretch_{WAY}"]["value"]
    F0 = np.reshape(model.materials["tissue"].parameters["F0"], (3, 3))
    np.testing.assert_allclose(F0, np.diag([reported, 1.0, 1 / reported]), atol=1e-6)
    read = limbcli.StatesFitResult.read(out, "p1")
    assert read.parameter(UNLOADED).flag == "identified"
    assert read.states["bent"][f"stretch_{WAY}"]["value"] == reported
    assert read.least_stiffness[WAY]["told"]
    assert read.model("bent").materials["tissue"].law == "prestrain"
    rules = ["[states.p1]", "m = { value = 6.0, relative = 0.2 }"]
    rules += [f'"least_stiffness.{WAY}.told" = {{ is = true }}', ""]
    (case.folder / "expected.toml").write_text("\n".join(rules))
    assert all(each.holds for each in compare(case.folder, out))


@pytest.mark.slow
def test_a_changed_state_breaks_the_chain(case_and_out, fitted):
    case, out = case_and_out
    chain = Chain(case, out)
    assert chain.broken(fitted) is None
    path = case.folder / "straight.csv"
    before = path.read_text()
    try:
        path.write_text(before + "6.1,3.5,2.9\n")
        broken = chain.broken(fitted)
        assert broken is not None
        assert "state/straight of site p1 changed" in broken.what
        assert "--objective states" in broken.fix(case, out)
    finally:
        path.write_text(before)


@pytest.mark.slow
def test_states_on_one_slope_leave_the_lowest_point_open(levels, tmp_path):
    """Two stretched states close together, speeds of little weight: it says that it is not told."""
    few = {name: levels[name] for name in ("middle", "straight")}
    read = state_case.noisy(few, 3)
    reported = {name: state_case.TOLD[name] for name in few}
    case = state_case.make_case(tmp_path / "case", tmp_path / "out", read, reported)
    text = case.file.read_text().replace("swe_level_fraction = 0.03", "swe_level_fraction = 0.5")
    case.file.write_text(text.replace("depth_mm = 0.05", "depth_mm = 2.0"))
    found = fit_states(
        Case.open(case.folder),
        out=tmp_path / "out",
        options=FitOptions(gain_deviation=0.3, max_interval_solves=0),
    )[0]
    least = found.data["least_stiffness"][WAY]
    assert not least["told"]
    assert "these data do not determine the state of least stiffness" in least["words"]
    assert least["by_parabola_through_states"] == {"stretch": None, "low": None, "high": None, "told": False}
    assert any("not determined by these data" in each for each in found.data["undetermined"])
    assert set(found.data["undetermined"]) <= set(found.warnings)


@pytest.mark.slow
def test_knots_reach_a_little_beyond_the_deepest_state(case_and_out):
    case, _ = case_and_out
    measured = states_of(case.sites[0])
    deepest = max(each.levels.depth.max() for each in measured)
    assert knots(measured)[-1] == pytest.approx(1.05 * deepest, abs=2e-3)


def test_states_are_asked_for_by_name_and_only_where_there_are_any(case_and_out, tmp_path):
    check_choice("states", FitOptions(law="fibres"))
    with pytest.raises(CaseError, match="laws are compared by the joint fit only"):
        check_choice("states", FitOptions(compare_laws=True))
    with pytest.raises(CaseError, match="use force, joint or states"):
        check_choice("state", FitOptions())
    plain = block.make_case(
        tmp_path / "case", tmp_path / "out", np.array([1.0, 2.0]), np.array([1.0, 2.5]), c=0.006, build=False
    )
    with pytest.raises(CaseError, match="no requested site has states"):
        fit_states(plain, out=tmp_path / "out", options=FitOptions())


def test_interval_of_a_derived_quantity_is_that_of_a_linear_problem():
    """a + 2 b of two independent readings: value +- 1.96 sqrt(1 + 4 * 0.25), by hand."""
    read, deviation = np.array([5.0, 3.0]), np.array([1.0, 0.5])

    def objective(theta, derivative=True):
        return Residual((theta - read) / deviation, np.diag(1 / deviation))

    parameters = [FitParameter("a", 4.0, 0.1, 100.0, "log"), FitParameter("b", 4.0, 0.1, 100.0, "log")]
    best = best_of(objective, parameters, [np.array([4.0, 4.0])])

    def total(theta):
        return float(theta[0] + 2 * theta[1])

    found = derived_interval(objective, parameters, best, total, 2.0, 40.0, 0.5)
    assert found.value == pytest.approx(11.0, abs=1e-3)
    half = 1.95996 * np.sqrt(2.0)
    assert (found.low, found.high) == pytest.approx((11.0 - half, 11.0 + half), abs=0.03)
    assert not found.open_low
    assert not found.open_high
    noisier = derived_interval(
        objective, parameters, best, total, 2.0, 40.0, 0.5, scale=4.0
    )  # the noise's variance four times as large as stated
    assert (noisier.low, noisier.high) == pytest.approx((11.0 - 2 * half, 11.0 + 2 * half), abs=0.03)
    short = derived_interval(objective, parameters, best, total, 10.5, 12.0, 0.5)
    assert short.open_low
    assert short.open_high
    narrow = [FitParameter("a", 5.0, 4.9, 5.1, "log"), FitParameter("b", 3.0, 2.9, 3.1, "log")]
    by_bounds = derived_interval(objective, narrow, best, total, 2.0, 40.0, 0.5)
    assert by_bounds.open_low  # what ended it is the bounds, of which the data say nothing
    assert by_bounds.open_high
