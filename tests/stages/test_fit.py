"""fit, on a block whose parameters are known: what it finds, what it leaves, what it refuses."""

import csv
import json
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from lxml import etree
from scipy.io import loadmat

from limbcli.case import Case
from limbcli.config import shares
from limbcli.errors import CaseError, MeasurementError
from limbcli.feb.read import read_feb
from limbcli.fitting import force_curves
from limbcli.fitting.force_curves import FileCurve, ReferenceCurve
from limbcli.fitting.numerical_error import gain_deviation
from limbcli.inference.prediction import SolvedPoints
from limbcli.progress import Progress
from limbcli.results import StageResult, plain
from limbcli.solvers.febio import FebioSolver
from limbcli.solvers.reference import ReferenceSolver
from limbcli.stages.fit import START, FitOptions, fit, initial_stiffness
from limbcli.stages.fit_joint import fit_joint
from limbcli.stages.limb_field.site_force import force_reading
from tests.stages import block_case as block

TRUTH = {"c": 0.008, "f_kappa": 150.0, "m": 3.0}
DEPTHS = np.array([0.9, 1.8, 2.7, 3.6])


@pytest.fixture(scope="module")
def forces() -> np.ndarray:
    return block.true_curve("tet4", DEPTHS, **TRUTH)


@pytest.fixture(scope="module")
def fitted(forces, tmp_path_factory) -> tuple[StageResult, list]:
    root = tmp_path_factory.mktemp("block")
    case = block.make_case(root / "case", root / "out", DEPTHS, forces, c=TRUTH["c"])
    seen = []
    progress = Progress(lambda kind, facts: seen.append((kind, facts)))
    options = FitOptions(max_interval_solves=3)
    return fit(case, out=root / "out", solver="reference", options=options, progress=progress)[0], seen


def test_parameters_are_recovered_within_one_per_cent(fitted):
    data = fitted[0].data
    assert data["c_kpa"] == pytest.approx(8.0, rel=1e-9)
    assert data["f_kappa"] == pytest.approx(150.0, rel=0.01)
    assert data["m"] == pytest.approx(3.0, rel=0.01)
    assert data["kappa_kpa"] == pytest.approx(1200.0, rel=0.01)
    assert data["r2"] > 0.999999
    assert data["rmse_n"] < 0.005


def test_what_the_force_says_of_the_tissue_is_left_for_the_limb(fitted):
    """The fitted tissue gives the fitted force, twice the c twice of it; the noise is that of 0.05 N and of
    0.1 mm times the slope; the first of the model's errors is the mesh's."""
    data = fitted[0].data
    told = data["tissue_force"]
    read = force_reading(plain({**data, "boundary_check": None}), c_kpa=data["c_kpa"])
    assert told["contact_penalty"] == 20.0
    logs = np.log([1e-3 * data["c_kpa"], data["m"], data["f_kappa"]])
    np.testing.assert_allclose(read.off(logs), 0.0, atol=1e-3)
    at, slopes = read.predict(logs + np.log([2.0, 1.0, 1.0]))
    np.testing.assert_allclose(np.exp(at), 2.0 * np.array(told["fitted_n"]), rtol=1e-3)
    np.testing.assert_allclose(slopes[:, 0], 1.0)
    step = np.array([0.0, 0.02, -0.02])
    other = read.predict(logs + step)[0] - read.predict(logs)[0]
    np.testing.assert_allclose(other, read.predict(logs)[1] @ step, rtol=0.1)
    slope = np.gradient(np.r_[0.0, told["fitted_n"]], np.r_[0.0, told["depths_mm"]])[1:]
    counted = np.sqrt(data["noise_scale"] ** 2 * (0.05**2 + (0.1 * slope) ** 2))
    np.testing.assert_allclose(told["noise_n"], counted, rtol=0.15)
    assert told["model_errors_of_ln"][0][0] == pytest.approx(data["numerical_error_fraction"])


def test_both_steps_are_told_with_their_numbers(fitted):
    steps = fitted[0].data["steps"]
    assert list(steps) == ["mooney-rivlin", "ogden"]
    assert steps["mooney-rivlin"]["m"] == 2.0
    assert steps["mooney-rivlin"]["rmse_n"] > steps["ogden"]["rmse_n"]
    assert steps["mooney-rivlin"]["history"][0]["f_kappa"] == 100.0
    for step in steps.values():
        assert step["n_iterations"] > 0
        assert set(step["flags"]) == set(step["words"]) == set(step["parameters"])


def test_intervals_hold_the_estimate_and_open_ones_are_null(fitted):
    data = fitted[0].data
    assert set(data["interval_95"]) == {"c_kpa", "f_kappa", "m"}
    for name, (low, high) in data["interval_95"].items():
        assert low is None or low < data[name]
        assert high is None or high > data[name]
    assert data["standard_error"]["f_kappa"] > 0.0
    assert data["correlation"]["c,f_kappa"] < -0.1, "a softer c is made up for by f_kappa"


def test_the_fitted_model_and_its_records_are_left(fitted):
    result = fitted[0]
    for name in ("feb", "log", "rigid_body", "nodes", "elements", "curves", "picture", "profiles"):
        assert result.path(name).stat().st_size > 0
    law = read_feb(result.path("feb")).materials["tissue"].parameters
    assert law["m1"] == pytest.approx(result.data["m"])
    assert law["kappa"] == pytest.approx(result.data["kappa_kpa"] / 1000.0)
    simulation = ReferenceSolver().read(result.path("feb"))
    assert simulation.probe_depth()[-1] == pytest.approx(DEPTHS[-1])


def test_either_step_counts_what_locking_makes_of_the_force_at_its_own_f_kappa(fitted):
    """With m = 2 another f_kappa stiffens the mesh: its interval has to allow for that."""
    steps = fitted[0].data["steps"]
    model = read_feb(fitted[0].path("feb"))
    for name in ("mooney-rivlin", "ogden"):
        own = gain_deviation(model, None, f_kappa=steps[name]["f_kappa"])
        assert steps[name]["numerical_error_fraction"] == pytest.approx(own)
    first, last = (steps[name]["numerical_error_fraction"] for name in ("mooney-rivlin", "ogden"))
    assert first > last
    assert fitted[0].data["numerical_error_fraction"] == last


def test_curves_hold_measured_and_simulated_forces(fitted, forces):
    with fitted[0].path("curves").open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["depth_mm", "measured_n", "start_n", "mooney-rivlin_n", "ogden_n"]
    measured = [(float(r["measured_n"]), float(r["ogden_n"])) for r in rows if r["measured_n"]]
    np.testing.assert_allclose([m for m, _ in measured], np.r_[0.0, forces], rtol=1e-5)
    np.testing.assert_allclose([o for _, o in measured], np.r_[0.0, forces], rtol=2e-3, atol=1e-9)


def test_results_are_left_for_other_programs(fitted):
    result = fitted[0]
    with result.path("parameters").open() as stream:
        rows = {(row["step"], row["parameter"]): row for row in csv.DictReader(stream)}
    assert float(rows["ogden", "m"]["value"]) == pytest.approx(result.data["m"], rel=1e-6)
    assert rows["mooney-rivlin", "f_kappa"]["flag"]
    mat = loadmat(result.path("mat"), simplify_cells=True)["fit"]
    assert mat["f_kappa"] == pytest.approx(result.data["f_kappa"])
    assert set(mat) == set(result.data) > {"misfit", "contact_check", "swe"}
    assert mat["steps"]["mooney_rivlin"]["m"] == 2.0
    snippet = etree.fromstring(result.path("material").read_text().split("-->")[1].strip())
    assert snippet.get("type") == "Ogden unconstrained"
    assert float(snippet.findtext("m1")) == pytest.approx(result.data["m"], rel=1e-9)


def test_progress_and_summary_speak(fitted):
    result, seen = fitted
    kinds = [kind for kind, _ in seen]
    assert {"stage", "fit"} <= set(kinds)
    reported = result.data["steps"]["ogden"]["parameters"]["f_kappa"]["headline"]
    assert any(line.startswith("f_kappa") and reported in line for line in result.summary)
    json.dumps(result.to_json(), allow_nan=False)


def test_headlines_of_a_good_fit_are_numbers_and_it_is_not_called_poor(fitted):
    result = fitted[0]
    assert not result.data["misfit"]["poor"]
    assert result.data["misfit"]["noise_rms_n"] > 0.05, "the depth's noise counts through the slope"
    assert not any("poor" in line for line in (*result.summary, *result.warnings))
    reported = result.data["steps"]["ogden"]["parameters"]["m"]
    assert reported["flag"] != "at bound"
    assert reported["value"] == pytest.approx(3.0, rel=0.01)


@pytest.mark.slow
def test_a_fit_that_misses_its_data_is_called_poor_first(tmp_path, forces):
    """Forces that no curve of the law can follow."""
    odd = forces[-1] * np.array([0.8, 0.9, 0.96, 1.0])
    case = block.make_case(tmp_path / "case", tmp_path / "out", DEPTHS, odd, c=TRUTH["c"])
    options = FitOptions(intervals=False, contact_check=False, boundary_check=False, max_iterations=4)
    result = fit(case, out=tmp_path / "out", solver="reference", options=options)[0]
    assert result.summary[0].startswith("bad: it differs from the measured force by ")
    assert result.warnings[0].startswith("poor fit")
    assert result.data["misfit"]["times_noise"] > 2.0
    for name in ("f_kappa", "m"):
        lines = [line for line in result.summary if line.startswith(name)]
        reported = result.data["steps"]["ogden"]["parameters"][name]
        assert reported["headline"] in lines[0]
        if reported["flag"] == "at bound":
            assert f"{reported['value']:.4g}" not in lines[0], "a bound of the search is no result"


@pytest.mark.slow
def test_a_fit_with_another_option_solves_nothing_twice(tmp_path):
    forces, model = np.array([0.9, 2.4, 4.6]), block.block_model(counts=(4, 4, 2))
    case = block.make_case(tmp_path / "case", tmp_path / "out", DEPTHS[:3], forces, c=TRUTH["c"], model=model)
    seen: list[str] = []
    first, again = (
        fit(
            case, out=tmp_path / "out", solver="reference",
            options=FitOptions(intervals=False, contact_check=False, boundary_check=True, c_deviation=each),
            progress=Progress(lambda kind, facts: seen.append(kind)),
        )[0].data
        for each in (0.05, 0.1)
    )  # fmt: skip
    assert first["n_kept_solves"] == 0
    assert seen.count("solve") == first["n_solves"] == again["n_kept_solves"]
    assert again["cold_solve_seconds"] is None or np.isnan(again["cold_solve_seconds"])
    for name in ("f_kappa", "m", "boundary_check", "n_solves"):
        assert again[name] == first[name]


@pytest.fixture
def case(forces, tmp_path) -> Case:
    return block.make_case(tmp_path / "case", tmp_path / "out", DEPTHS, forces, c=TRUTH["c"])


def test_a_changed_measurement_is_noticed(case, tmp_path):
    levels = case.sites[0].levels
    levels.write_text(levels.read_text().replace("\n0,0,", "\n0.01,0,"))
    with pytest.raises(CaseError, match="build-feb"):
        fit(case, out=tmp_path / "out", solver="reference")


def test_without_speed_at_level_0_c_must_be_given(case, tmp_path, forces):
    levels = block.read_levels(case.sites[0].levels)
    silent = replace(levels, swe_mean_m_per_s=np.full(len(levels), np.nan))
    with pytest.raises(MeasurementError, match="--c-kpa"):
        initial_stiffness(silent, case.sites[0], FitOptions())
    given, source = initial_stiffness(silent, case.sites[0], FitOptions(c_kpa=6.0))
    assert given.c == pytest.approx(0.006)
    assert "--c-kpa" in source
    with pytest.raises(MeasurementError, match=r"possible values are 0\.1 to 500"):
        initial_stiffness(silent, case.sites[0], FitOptions(c_kpa=-1.0))


@pytest.mark.slow
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_without_stated_noise_nothing_is_claimed_of_how_sure_the_parameters_are(case, tmp_path):
    text = (
        case.file.read_text()
        .replace("force_n = 0.05", "force_n = 0")
        .replace("depth_mm = 0.1", "depth_mm = 0")
    )
    silent = "swe_level_fraction = 0\nswe_pixel_fraction = 0\n"
    case.file.write_text(text.replace('source = "assumed"', f'{silent}source = "assumed"'))
    silent_case = Case.open(case.folder)
    options = FitOptions(contact_check=False, boundary_check=False)
    result = fit(silent_case, out=tmp_path / "out", solver="reference", options=options)[0]
    data = result.data
    assert data["f_kappa"] == pytest.approx(150.0, rel=0.01)
    assert data["r2"] > 0.999999
    assert data["standard_error"]["f_kappa"] is None
    assert "tissue_force" not in data
    assert set(data["interval_95"]) == {"c_kpa"}
    assert data["flags"]["f_kappa"] == data["flags"]["m"] == "weak"
    assert "states no noise" in data["words"]["m"]
    assert any("no interval" in line for line in result.summary)
    assert any("[site.noise]" in text for text in result.warnings)
    with pytest.raises(CaseError, match="states no noise"):
        fit_joint(silent_case, out=tmp_path / "out")


def test_deviation_of_c_is_that_of_the_speed_twice(case):
    stiffness, _ = initial_stiffness(block.read_levels(case.sites[0].levels), case.sites[0], FitOptions())
    assert stiffness.log_deviation == pytest.approx(2 * np.hypot(0.05, 0.10 / np.sqrt(100)))


@pytest.mark.slow
def test_a_solver_on_files_gives_the_same_curve_and_derivative(case, tmp_path):
    """Twin: the session's exact derivative against differences of two runs side by side."""
    model = read_feb(tmp_path / "out" / "build-feb" / "p1" / "model.feb")
    exact = ReferenceCurve(model, c=TRUTH["c"])
    files = FileCurve(ReferenceSolver(threads=1), model, c=TRUTH["c"])
    one, other = exact(START), SolvedPoints(files.differentiable(relative_step=1e-3))(START, (0, 1))
    exact.close()
    np.testing.assert_allclose(other.values, one.values, rtol=1e-5)
    np.testing.assert_allclose(files.depths, exact.depths, rtol=1e-9)
    np.testing.assert_allclose(
        other.jacobian, one.jacobian, rtol=0.02, atol=0.01 * np.abs(one.jacobian).max(0).min()
    )


def test_side_by_side_keeps_the_order_and_raises_errors(case, tmp_path):
    model = read_feb(tmp_path / "out" / "build-feb" / "p1" / "model.feb")
    side_by_side = FileCurve(ReferenceSolver(threads=1), model, c=TRUTH["c"]).run_side_by_side
    assert list(side_by_side(lambda x: x**2, [np.array([1.0]), np.array([3.0])])) == [1.0, 9.0]
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda x: 1 / 0, [np.array([1.0])])


@pytest.mark.parametrize("cores", [1, 2, 5])
def test_febio_runs_use_the_cores_and_never_more(cores, case, tmp_path, monkeypatch):
    monkeypatch.setattr(force_curves, "available_cores", lambda: cores)
    model = read_feb(tmp_path / "out" / "build-feb" / "p1" / "model.feb")
    files = FileCurve(FebioSolver(), model, c=TRUTH["c"])
    gate, now, most = threading.Lock(), [0], [0]

    def run(theta: np.ndarray) -> float:
        threads = files._solver.threads
        with gate:
            now[0] += threads
            most[0] = max(most[0], now[0])
        time.sleep(0.05)
        with gate:
            now[0] -= threads
        return float(theta[0])

    assert files.run_side_by_side(run, [np.array([float(k)]) for k in range(3)]) == [0.0, 1.0, 2.0]
    assert cores - 3 < most[0] <= cores  # of five, three with one thread each
    assert shares(1, cores) == (1, cores)


@pytest.mark.slow
def test_the_mesh_error_is_counted_stated_and_can_be_given(fitted, forces, tmp_path):
    """Forces are proportional to c: an error common to them adds to c's own."""
    data = fitted[0].data
    assert 0.05 < data["numerical_error_fraction"] < 0.9, "by element and edge length"
    assert any("property of this mesh" in each for each in fitted[0].warnings)
    case = block.make_case(tmp_path / "case", tmp_path / "out", DEPTHS, forces, c=TRUTH["c"])
    options = FitOptions(intervals=False, gain_deviation=0.0, contact_check=False, boundary_check=False)
    exact = fit(case, out=tmp_path / "out", solver="reference", options=options)[0].data
    assert exact["numerical_error_fraction"] == 0.0
    for name in ("f_kappa", "m"):
        assert exact["standard_error"][name] < data["standard_error"][name]
    assert exact["standard_error"]["c_kpa"] == pytest.approx(data["standard_error"]["c_kpa"])


def test_what_a_harder_contact_changes_is_told(fitted, forces):
    check = fitted[0].data["contact_check"]
    assert (check["penalty"], check["tried"]) == (20.0, 80.0)
    change = np.array(check["force_change_fraction"])
    assert check["depths_mm"] == pytest.approx(DEPTHS[[0, 2, 3]], rel=1e-3)
    harder = block.true_curve("tet4", DEPTHS, **TRUTH, penalty=80.0)
    assert change == pytest.approx((harder / forces - 1.0)[[0, 2, 3]], abs=2e-3)
    assert np.all(change > 0.005)
    assert any("with a contact 4 times as stiff the force changes" in line for line in fitted[0].summary)


@pytest.mark.slow
def test_a_contact_that_the_fit_makes_up_for_is_warned_of(forces, tmp_path):
    case = block.make_case(tmp_path / "case", tmp_path / "out", DEPTHS, forces, c=TRUTH["c"], penalty=2.0)
    options = FitOptions(intervals=False)
    result = fit(case, out=tmp_path / "out", solver="reference", options=options)[0]
    assert any("--contact-penalty 8 and fit again" in line for line in result.warnings)


@pytest.mark.slow
def test_forces_too_low_for_the_speed_do_not_pass_as_a_good_fit(tmp_path, forces):
    """As in another unit: tissue without resistance to a change of volume fits them, which no tissue is."""
    low = forces * (1.0 / forces[-1])
    case = block.make_case(tmp_path / "case", tmp_path / "out", DEPTHS, low, c=TRUTH["c"])
    options = FitOptions(max_interval_solves=3, gain_deviation=0.05)
    found = fit(case, out=tmp_path / "out", solver="reference", options=options)[0]
    assert found.data["agreement"]["state"] == "bad"
    assert found.summary[0].startswith("bad: the forces are too low for the shear-wave speed at rest")
