"""The joint fit and the comparison of elements, on a block whose parameters are known."""

import csv
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import loadmat

from limbcli.case import Case
from limbcli.errors import CaseError, FitError, MeasurementError
from limbcli.feb.settings import schedule
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.laws import LAWS, law_named
from limbcli.fitting.numerical_error import edge_under_probe, gain_deviation
from limbcli.model.npz_file import save_model
from limbcli.results import open_stage
from limbcli.site_model.indentation_model import indentation_model, with_penalty
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.build_feb import TissueOptions, build_feb
from limbcli.stages.fit import FitOptions, check_choice
from limbcli.stages.fit_elements import compare_elements
from limbcli.stages.fit_joint import fit_joint
from tests.stages import block_case as block

pytestmark = pytest.mark.slow

C, SHAPE = 0.008, np.array([20.0, 5.0])
UNCHECKED = FitOptions(contact_check=False, boundary_check=False)
DEPTHS = np.array([0.9, 1.8, 2.7, 3.6])


def law_curve(name="ogden", *, counts=(8, 6, 3), **options):
    tissue = block.block_model(counts=counts)
    model = indentation_model(tissue, schedule(list(DEPTHS)), c=C, f_kappa=100.0, m=2.0)
    return LawCurve(model, LAWS[name], c=C, density_kg_per_m3=1000.0, **options)


@pytest.fixture(scope="module")
def measured() -> np.ndarray:
    curve = law_curve()
    values = curve(SHAPE, (0, 1)).values
    curve.close()
    return values


@pytest.fixture(scope="module")
def case_and_out(measured, tmp_path_factory):
    root = tmp_path_factory.mktemp("joint")
    forces, speeds = np.split(measured, 2)
    case = block.make_case(root / "case", root / "out", DEPTHS, forces, c=C, speeds=speeds)
    return case, root / "out"


@pytest.fixture(scope="module")
def joint(case_and_out):
    case, out = case_and_out
    return fit_joint(case, out=out, options=FitOptions(max_interval_solves=6))


@pytest.mark.slow
def test_tissue_is_recovered_with_c_free(joint):
    assert joint.data["c_kpa"] == pytest.approx(8.0, rel=0.01)
    assert joint.data["f_kappa"] == pytest.approx(20.0, rel=0.03)
    assert joint.data["m"] == pytest.approx(5.0, rel=0.03)
    assert joint.data["chi_square"] < 0.05
    assert joint.data["n_freedom"] == 4 + 5 - 3


@pytest.mark.slow
def test_linear_elements_are_warned_of(joint):
    """As in a fit of the force: on them f_kappa says how stiff the mesh is."""
    assert sum("f_kappa is a property of this mesh" in each for each in joint.warnings) == 1


@pytest.mark.slow
def test_what_a_harder_contact_changes_is_told_of_every_site(joint, measured):
    check = joint.data["contact_check"]["p1"]
    assert (check["penalty"], check["tried"]) == (20.0, 80.0)
    harder = indentation_model(block.block_model(), schedule(list(DEPTHS)), c=C, f_kappa=SHAPE[0], m=SHAPE[1])
    session = ReferenceSession(with_penalty(harder, 80.0))
    expected = session.solve().must_points.forces / np.split(measured, 2)[0] - 1.0
    session.close()
    assert check["force_change_fraction"] == pytest.approx(expected, abs=3e-3)
    assert np.max(expected) > 0.005
    assert any(line.startswith("p1: with a contact 4 times as stiff") for line in joint.summary)


@pytest.mark.slow
def test_every_parameter_has_interval_flag_and_words(joint):
    for name, each in joint.data["parameters"].items():
        low, high = joint.data["interval_95"][name]
        assert low is None or low < each["value"]
        assert high is None or each["value"] < high
        assert each["flag"]
        assert each["words"].endswith(".")


@pytest.mark.slow
def test_levels_and_exports_are_left(joint):
    with joint.path("levels_p1").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["quantity"] for row in rows} == {"depth_mm", "speed_m_per_s"}
    for row in rows:
        assert float(row["predicted"]) == pytest.approx(float(row["measured"]), rel=0.01)
    mat = loadmat(joint.path("mat"), simplify_cells=True)["fit"]
    assert mat["m"] == pytest.approx(joint.data["m"])
    assert set(mat) == set(joint.data)
    for name in ("picture", "profiles", "material", "parameters"):
        assert joint.path(name).stat().st_size > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LAWS))
def test_derivatives_of_every_law_are_those_of_differences(name):
    curve = law_curve(name, counts=(6, 5, 2), speeds=False)
    shape = np.array([each.start for each in LAWS[name].shape])
    exact = curve(shape, tuple(range(len(shape))))
    for k in range(len(shape)):
        up, down = shape.copy(), shape.copy()
        up[k], down[k] = 1.002 * shape[k], shape[k] / 1.002
        rise = (curve(up).values - curve(down).values) / (up[k] - down[k])
        scale = np.abs(exact.jacobian[:, k]).max()
        np.testing.assert_allclose(exact.jacobian[:, k], rise, atol=0.02 * scale)
    curve.close()


@pytest.mark.parametrize("name", sorted(LAWS))
def test_forces_are_proportional_to_c_at_fixed_shape(name):
    """What lets c move without a simulation."""
    model = indentation_model(
        block.block_model(counts=(6, 5, 2)), schedule([0.9, 1.8]), c=C, f_kappa=100.0, m=2.0
    )
    shape, forces = np.array([each.start for each in LAWS[name].shape]), []
    for c in (0.008, 0.012):
        curve = LawCurve(model, LAWS[name], c=c, density_kg_per_m3=1000.0, speeds=False)
        forces.append(curve(shape).values)
        curve.close()
    np.testing.assert_allclose(forces[1], 1.5 * forces[0], rtol=1e-5)


@pytest.mark.slow
def test_laws_are_compared_by_what_they_did_not_see(case_and_out, monkeypatch):
    """All that there are: here three, to be quick."""
    case, out = case_and_out
    three = {name: LAWS[name] for name in ("ogden", "mooney-rivlin", "neo-hooke")}
    monkeypatch.setattr("limbcli.stages.fit_joint.LAWS", three)
    result = fit_joint(case, out=out, options=replace(UNCHECKED, compare_laws=True, max_interval_solves=1))
    errors = {row["law"]: row["held_out_depth_mm"] for row in result.data["laws"]}
    assert set(errors) == set(three)
    assert errors["ogden"] < 0.5 * errors["mooney-rivlin"]
    assert errors["ogden"] < 0.5 * errors["neo-hooke"]
    assert list(errors.values()) == sorted(errors.values())
    assert result.path("laws").stat().st_size > 0


@pytest.fixture(scope="module")
def second_without_speeds(measured, tmp_path_factory):
    """The same measurement at a second site, where no speed was read."""
    root = tmp_path_factory.mktemp("second")
    forces, speeds = np.split(measured, 2)
    folder, out = root / "case", root / "out"
    block.make_case(folder, out, DEPTHS, forces, c=C, speeds=speeds)
    text = (folder / "case.toml").read_text()
    site = text[text.index("[[site]]") :].replace('"p1"', '"p2"').replace("levels.csv", "bare.csv")
    (folder / "case.toml").write_text(f"{text}\n{site}")
    rows = [
        f"{force:.12g},{depth:.12g}" for force, depth in zip(np.r_[0, forces], np.r_[0, DEPTHS], strict=True)
    ]
    (folder / "bare.csv").write_text("\n".join(["force_n,depth_mm", *rows]) + "\n")
    with open_stage(out, "mesh", subject="B1", site="p2") as writer:
        save_model(block.block_model(), writer.file("model", "model.npz"))
    case = Case.open(folder)
    build_feb(case, out=out, sites=["p1"])
    build_feb(case, out=out, sites=["p2"], options=TissueOptions(c_kpa=12.0))
    return case, out


def test_c_is_told_by_the_speeds_of_one_site_of_two(second_without_speeds, joint):
    """What is given by hand, for both or at `build-feb` of the other, is only where the search begins."""
    case, out = second_without_speeds
    options = replace(UNCHECKED, c_kpa=12.0, max_interval_solves=2)
    found = fit_joint(case, out=out, options=options)
    assert found.data["c_kpa"] == pytest.approx(8.0, rel=0.02)
    assert found.data["chi_square"] < 0.1
    assert any(text.startswith("--c-kpa 12: the shear-wave speeds determine c") for text in found.warnings)
    assert not any("--c-kpa" in text for text in joint.warnings)
    (told,) = [text for text in found.warnings if "no shear-wave speed at any level" in text]
    assert told.startswith("site p2: ")


def test_c_of_a_site_alone_without_speeds_must_be_given(second_without_speeds):
    case, out = second_without_speeds
    with pytest.raises(MeasurementError, match="c is unknown"):
        fit_joint(case, out=out, sites=["p2"])


@pytest.mark.slow
def test_a_comparison_keeps_to_the_iterations_allowed(case_and_out):
    case, out = case_and_out
    with pytest.raises(FitError, match="1 iteration"):
        compare_elements(case, out=out, options=FitOptions(max_iterations=1))


@pytest.mark.slow
def test_elements_are_compared_and_the_mesh_is_named(case_and_out):
    case, out = case_and_out
    result = compare_elements(case, out=out, options=FitOptions(tolerance=0.05))[0]
    elements = result.data["elements"]
    assert elements["tet4"]["f_kappa"] == pytest.approx(20.0, rel=0.05)
    assert elements["tet10"]["n_unknowns"] > 5 * elements["tet4"]["n_unknowns"]
    assert result.data["force_ratio_tet4_over_tet10"] > 1.5, "tet4 locks"
    rise = result.data["force_rise_f_kappa_10_to_650"]
    assert rise["tet4"] > 2 * rise["tet10"]
    assert result.path("picture").stat().st_size > 0


def test_wrong_choices_are_refused_with_a_fix():
    with pytest.raises(CaseError, match="did you mean 'ogden'"):
        law_named("ogdn")
    with pytest.raises(CaseError, match="force, joint or states"):
        check_choice("both", FitOptions())
    with pytest.raises(CaseError, match="reference solver supports it"):
        check_choice("joint", FitOptions(), solver="febio")


@pytest.mark.slow
def test_a_mesh_study_says_the_numerical_error(case_and_out):
    case, out = case_and_out
    with open_stage(out, "mesh-study", subject="B1", site="p1") as writer:
        writer.data["numerical_error_fraction"] = 0.021
    result = fit_joint(case, out=out, options=FitOptions(law="mooney-rivlin", max_interval_solves=0))
    shutil.rmtree(out / "mesh-study")
    assert result.data["gain_deviations"] == {"p1": 0.021}


def test_numerical_error_goes_with_element_and_size():
    quadratic, linear = block.block_model("tet10"), block.block_model("tet4")
    assert gain_deviation(linear, None) > 2 * gain_deviation(quadratic, None) > 0.0
    assert gain_deviation(linear, 0.07) == 0.07
    locked = 0.5 * np.log(2.47) * max(1.0, edge_under_probe(linear) / 3.0)
    assert gain_deviation(linear, None, f_kappa=100.0) == pytest.approx(locked)
    assert gain_deviation(linear, None, studied=0.02, f_kappa=100.0) == pytest.approx(locked)
    assert gain_deviation(linear, None, studied=2.0, f_kappa=100.0) == 2.0
    assert gain_deviation(quadratic, None, studied=0.02, f_kappa=100.0) == 0.02
    assert gain_deviation(quadratic, None, f_kappa=100.0) == gain_deviation(quadratic, None)


def test_linear_tetrahedra_lock_the_more_the_coarser_they_are():
    """At edges of 4.6 mm a model with tet4 and one with tet10 gave forces in the ratio 4.7 at f_kappa 100."""
    model = block.block_model("tet4")
    scale = 4.6 / edge_under_probe(model)
    coarse, fine = (
        replace(model, mesh=replace(model.mesh, points=k * model.mesh.points)) for k in (scale, 0.3 * scale)
    )
    assert gain_deviation(coarse, None, f_kappa=100.0) == pytest.approx(0.5 * np.log(4.7), rel=0.15)
    assert gain_deviation(fine, None, f_kappa=100.0) == pytest.approx(0.5 * np.log(2.47))
