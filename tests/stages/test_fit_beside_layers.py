"""Fits that search c beside a layer that keeps a stiffness of its own: c is simulated, not scaled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.feb.settings import schedule
from limbcli.fitting.force_curves import FileCurve, LawCurve, ReferenceCurve
from limbcli.fitting.laws import LAWS
from limbcli.fitting.state_curve import StateCurve
from limbcli.fitting.state_plan import plan_of
from limbcli.inference.monotone_interpolation import pchip_inverse, pchip_sample
from limbcli.inference.site_depth import SiteMeasurement
from limbcli.model import ElementMap, LimbModel
from limbcli.model.npz_file import save_model
from limbcli.results import open_stage
from limbcli.site_model.indentation_model import indentation_model
from limbcli.site_model.prestretch import in_state
from limbcli.site_model.site_layers import LayerLaw, with_layer_laws
from limbcli.solvers.reference import ReferenceSolver
from limbcli.stages.build_feb import TissueOptions, build_feb
from limbcli.stages.fit import FitOptions, fit
from limbcli.stages.fit_joint import fit_joint
from limbcli.stages.fit_states import identify
from tests.stages import block_case
from tests.stages.test_site_layers import layered_block

C0, TRUE_C = 0.008, 0.009  # MPa
SHAPE = np.array([40.0, 3.0])  # f_kappa, m
DEPTHS = [0.8, 1.6, 2.4, 3.2]
FAT = {"c_kpa": 2.0, "f_kappa": 20.0, "m": 2.0}
DENSITY = 1000.0


def beside_fat(c: float, *, f_kappa: float = 20.0) -> LimbModel:
    layered = with_layer_laws(layered_block(), {"fat": LayerLaw(c=0.002, f_kappa=f_kappa, m=2.0)})
    return indentation_model(layered, schedule(DEPTHS), c=c, f_kappa=40.0, m=3.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ogden", "two-term-ogden"])
def test_forces_have_exact_derivatives_by_c_and_are_not_in_proportion_to_it(name: str) -> None:
    law, n = LAWS[name].beside_layers(), len(DEPTHS)
    curve = LawCurve(beside_fat(C0), law, c=C0, density_kg_per_m3=DENSITY, speeds=False)
    place = np.array([1.3, *(each.start for each in law.shape[1:])])
    try:
        found = curve(place, tuple(range(len(place))))
        up, down = (curve(np.r_[place[0] * h, place[1:]]).values for h in (1.001, 0.999))
    finally:
        curve.close()
    np.testing.assert_allclose(found.jacobian[:n, 0], (up - down) / (0.002 * place[0]), rtol=2e-5)
    share = found.jacobian[:n, 0] * place[0] / found.values[:n]
    assert share.max() < 0.5, "in proportion it would be 1"


def test_a_factor_of_c_is_c_itself() -> None:
    """What a curve gives for c / c0 is what the model gives at that c."""
    place = np.r_[TRUE_C / C0, SHAPE]
    by_ratio = LawCurve(beside_fat(C0), LAWS["ogden"].beside_layers(), c=C0, density_kg_per_m3=DENSITY)
    direct = LawCurve(beside_fat(TRUE_C), LAWS["ogden"], c=TRUE_C, density_kg_per_m3=DENSITY)
    try:
        np.testing.assert_allclose(by_ratio(place).values, direct(SHAPE).values, rtol=1e-4)
    finally:
        by_ratio.close()
        direct.close()


def case_beside_fat(folder: Path) -> Case:
    """A case whose tissue has TRUE_C and SHAPE, measured without error, beside fat of a known law."""
    curve = LawCurve(beside_fat(TRUE_C), LAWS["ogden"], c=TRUE_C, density_kg_per_m3=DENSITY)
    forces, speeds = np.split(curve(SHAPE).values, 2)
    curve.close()
    case = block_case.make_case(
        folder / "case", folder / "out", np.array(DEPTHS), forces, c=TRUE_C, speeds=speeds, build=False
    )
    text = case.file.read_text().replace("force_n = 0.05", "force_n = 0.002")
    case.file.write_text(text.replace("depth_mm = 0.1", "depth_mm = 0.004"))
    with open_stage(folder / "out", "mesh", subject=case.subject, site="p1") as writer:
        save_model(layered_block(), writer.file("model", "model.npz"))
    case = Case.open(case.folder)
    build_feb(case, out=folder / "out", options=TissueOptions(layers={"fat": FAT}))
    return case


@pytest.mark.slow
def test_the_joint_fit_finds_the_tissue_beside_fat(tmp_path: Path) -> None:
    """Begun at another c; with forces in proportion to c it would be a seventh too low."""
    case = case_beside_fat(tmp_path)
    options = FitOptions(
        c_kpa=1000 * C0, c_deviation=0.001, contact_check=False, boundary_check=False, gain_deviation=1e-4,
        max_interval_solves=12,
    )  # fmt: skip
    found = fit_joint(case, out=tmp_path / "out", options=options)
    assert found.data["c_kpa"] == pytest.approx(1000 * TRUE_C, rel=0.005)
    assert any("the shear-wave speeds determine c" in each for each in found.warnings)
    assert found.data["f_kappa"] == pytest.approx(SHAPE[0], rel=0.01)
    assert found.data["m"] == pytest.approx(SHAPE[1], rel=0.03)
    assert found.data["chi_square"] < 0.01


@pytest.mark.slow
def test_states_are_told_apart_beside_fat() -> None:
    true_c, c0, unloaded, shape = 0.0075, 0.006, 0.95, np.array([30.0, 6.0])
    given, depths, forces = {"around": [0.9, 0.72, 1.1]}, [0.4, 1.0, 1.8, 2.8, 3.8], np.arange(0.0, 1.7, 0.4)
    model, law, plan = beside_fat(c0, f_kappa=5.0), LAWS["ogden"], plan_of(given, {}, ["a", "b", "c"])
    ways = {"density_kg_per_m3": DENSITY}
    truth = StateCurve(model, law, ("around",), depths, c=true_c, **ways)
    data = []
    for name, stretch in zip("abc", given["around"], strict=True):
        theta, knots = np.r_[shape, stretch / unloaded], np.r_[0.0, depths]
        values, n = truth(theta).values, len(depths)
        depth = pchip_inverse(knots, np.r_[0.0, values[:n]], forces)
        speed = np.log(np.r_[values[2 * n], values[n : 2 * n]]) + truth.even_speed(theta)[0]
        speed = pchip_sample(knots, speed, depth).values
        data.append(
            SiteMeasurement(
                name, np.array(depths), forces[1:], depth[1:], 0.002, 0.005, forces, speed,
                np.full(len(forces), 0.01), 1e-4,
            )
        )  # fmt: skip
    truth.close()
    curve = StateCurve(model, law.beside_layers(), ("around",), depths, c=c0, **ways)
    problem, found = identify(curve, law, plan, data, max_rounds=0)
    try:
        np.testing.assert_allclose(found.best[:4], [true_c, *shape, unloaded], rtol=0.01)
        c = c0 * problem.blocks[1].place(found.best)[0]
        fitted = curve.in_state(model, problem.place(1, found.best), c=c).materials["tissue"]
        assert fitted.parts[0].parameters["c1"] == pytest.approx(true_c / 2, rel=0.01)
    finally:
        curve.close()


@pytest.mark.slow
def test_a_solver_on_files_tells_the_same_share_of_c() -> None:
    model, theta = beside_fat(C0), np.array([40.0, 3.0])
    exact, files = ReferenceCurve(model, c=C0), FileCurve(ReferenceSolver(threads=1), model, c=C0)
    try:
        share = exact.share_of_c(theta)
    finally:
        exact.close()
    assert share.min() > 0.1
    assert share.max() < 0.5, "the fat carries the rest"
    np.testing.assert_allclose(files.share_of_c(theta), share, rtol=0.01)
    block = model.mesh.block("tissue")
    mapped = ReferenceCurve(model, c=ElementMap("c", "tissue", np.full(len(block.cells), C0)))
    try:
        np.testing.assert_allclose(mapped.share_of_c(theta), share, rtol=1e-4)
    finally:
        mapped.close()


@pytest.mark.slow
def test_what_c_leaves_unsure_of_f_kappa_is_what_another_c_makes_of_it(tmp_path: Path) -> None:
    """Were all force in proportion to c, the standard error would be four times that."""
    case, found = case_beside_fat(tmp_path), {}
    for factor in (1.03, 1.0):
        options = FitOptions(
            c_kpa=1000 * TRUE_C * factor, c_deviation=0.05, gain_deviation=0.0, contact_check=False,
            boundary_check=False, intervals=factor == 1.0, max_interval_solves=1, tolerance=1e-4,
        )  # fmt: skip
        found[factor] = fit(case, out=tmp_path / "out", solver="reference", options=options)[0].data
    moved = np.log(found[1.03]["f_kappa"] / found[1.0]["f_kappa"]) / np.log(1.03)
    step = found[1.0]["steps"]["ogden"]
    by_c = step["standard_error"]["f_kappa"] * step["correlations"]["c,f_kappa"]
    assert by_c == pytest.approx(0.05 * moved * found[1.0]["f_kappa"], rel=0.05)
    low, high = step["interval_95"]["f_kappa"]
    assert np.log(high / low) == pytest.approx(
        2 * 1.96 * step["standard_error"]["f_kappa"] / step["f_kappa"], rel=0.1
    )
    assert found[1.0]["most_likely"]["c_kpa"] == pytest.approx(1000 * TRUE_C, rel=1e-3)


def test_layers_are_stretched_with_the_tissue() -> None:
    stretched = in_state(beside_fat(C0), [1.0, 2.0], along=1.0, around=1.1).materials
    assert stretched["fat"].law == stretched["tissue"].law == "prestrain"
    assert stretched["fat"].parameters["F0"] == stretched["tissue"].parameters["F0"]
