"""The joint fit with fibres: two orientations at one place are one tissue; what one cannot tell is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.feb.settings import schedule
from limbcli.fitting.fibres import rest_speed, share_along, undetermined
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.laws import FIBRE_F_KAPPA, LAWS, law_named
from limbcli.materials.energy import program_energy
from limbcli.materials.program import compile_material
from limbcli.model import ElementMap, LimbModel
from limbcli.model.npz_file import save_model
from limbcli.results import StageResult, open_stage
from limbcli.shear_waves.any_law import acoustic_tensor
from limbcli.shear_waves.from_simulation import AT_REST, level_maps
from limbcli.site_model.indentation_model import TISSUE, indentation_model, softer_jumps
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.build_feb import build_feb
from limbcli.stages.fit import FitOptions, check_choice
from limbcli.stages.fit_joint import fit_joint
from limbcli.stages.report import report
from tests.stages import block_case as block

C, SHAPE = 0.006, np.array([3.0, 1.0, 0.5])  # MPa; m, fibre_shear, fibre_tension
DEPTHS = np.array([0.9, 1.8, 2.7, 3.6])
ALONG = {"across": (0.0, 1.0, 0.0), "along": (1.0, 0.0, 0.0)}  # the fibres in each probe's frame
LAW = LAWS["fibres"]
OPTIONS = FitOptions(contact_check=False, boundary_check=False, law="fibres")
SECOND = """
[[site]]
name = "along"
position_mm = [0.0, 0.0, 0.0]
long_axis = "axial"
levels = "along.csv"
[site.noise]
force_n = 0.05
depth_mm = 0.1
source = "assumed"
"""


def sharp(text: str) -> str:
    """Less noise, so that less is left open."""
    return text.replace("force_n = 0.05", "force_n = 0.02").replace("depth_mm = 0.1", "depth_mm = 0.02")


def fibred(axis: tuple[float, float, float]) -> LimbModel:
    model = block.block_model(counts=(6, 5, 2))
    n = len(model.mesh.block("tissue").cells)
    return replace(model, fibres=ElementMap("fibres", "tissue", np.tile(np.array(axis), (n, 1))))


def built(axis: tuple[float, float, float]) -> LimbModel:
    return indentation_model(fibred(axis), schedule(list(DEPTHS)), c=C, f_kappa=100.0, m=2.0)


def closed_form(shape: np.ndarray, f: np.ndarray) -> float:
    """ln of the speed at rest along x, moving along z (m/s), 1000 kg/m3."""
    _, s, t = shape
    modulus = C * (0.5 + 0.5 * s * (f[0] ** 2 + f[2] ** 2) + 4 * t * f[0] ** 2 * f[2] ** 2)
    return 0.5 * float(np.log(modulus * 1e6 / 1000.0))


@pytest.mark.parametrize("axis", [(0, 1, 0), (1, 0, 0), (0.96, 0, -0.28), (0.6, 0.8, 0)])
def test_speed_at_rest_is_the_closed_form_and_so_are_its_slopes(axis):
    """Fibres within the image or across it: z is a mode of its own there, or nearly."""
    f = np.array(axis, dtype=float)
    value, slopes = rest_speed(built(axis), LAW.along(tuple(f)), c=C, density_kg_per_m3=1000.0)(SHAPE)
    assert value == pytest.approx(closed_form(SHAPE, f), abs=2e-3)
    for k in range(3):
        up, down = SHAPE.copy(), SHAPE.copy()
        up[k], down[k] = SHAPE[k] * 1.001, SHAPE[k] / 1.001
        rise = (closed_form(up, f) - closed_form(down, f)) / (2 * np.log(1.001))
        assert slopes[k] == pytest.approx(rise, abs=2e-3)


def test_speed_at_rest_is_the_mean_of_the_map_at_rest():
    """Twin: the weights of the window, and the predicted map."""
    model, law = built((0.96, 0.0, -0.28)), LAW.along((0.96, 0.0, -0.28))
    curve = LawCurve(model, law, c=C, density_kg_per_m3=1000.0, speeds=True)
    tissue = model.with_material("tissue", law.material(C, SHAPE))
    simulation = curve._session.solve(tissue, records=True).simulation
    curve.close()
    mean = level_maps(tissue, simulation, [AT_REST], density_kg_per_m3=1000.0)[0].speed_m_per_s.mean()
    at_rest = rest_speed(model, law, c=C, density_kg_per_m3=1000.0)(SHAPE)[0]
    assert at_rest == pytest.approx(float(np.log(mean)), abs=1e-4)  # m is that of the start


def test_acoustic_tensor_of_the_law_is_the_energys_second_difference(rng):
    """a.Q a = d2 W(F + e a N) / d e2 with the fibre clearly stretched."""
    law = LAW.along((0.8, 0.6, 0.0)).material(C, SHAPE)
    program = compile_material(law, "tissue").program(1, lambda name: 1.0)

    def energy(F: np.ndarray) -> float:
        return float(program_energy(program.ops, program.par, F[None, None])[0, 0])

    for _ in range(10):
        F = np.eye(3) + 0.1 * rng.standard_normal((3, 3))
        F[:, 0] += 0.25 * np.array([0.8, 0.6, 0.0])
        if np.linalg.norm(F @ [0.8, 0.6, 0.0]) < 1.05 or np.linalg.det(F) < 0.5:
            continue
        n = rng.standard_normal(3)
        n /= np.linalg.norm(n)
        a = np.cross(n, rng.standard_normal(3))
        a /= np.linalg.norm(a)
        N, h = F.T @ n, 1e-4
        W = [energy(F + e * np.outer(a, N)) for e in (h, 0.0, -h)]
        Q = acoustic_tensor(law, F[None], n)[0]
        assert a @ Q @ a == pytest.approx((W[0] - 2 * W[1] + W[2]) / h**2, rel=1e-4)


def test_speeds_under_load_are_those_of_the_law_and_go_on_from_rest():
    """The solve may ease the fibres in; waves feel them whole, so a small load changes the speed little."""
    model = indentation_model(fibred(ALONG["along"]), schedule([0.1, 0.2]), c=C, f_kappa=100.0, m=2.0)
    law = LAW.along(ALONG["along"])
    curve = LawCurve(model, law, c=C, density_kg_per_m3=1000.0)
    speeds = curve(SHAPE).values[2:]
    curve.close()
    at_rest = np.exp(rest_speed(model, law, c=C, density_kg_per_m3=1000.0)(SHAPE)[0])
    across = np.sqrt(0.5 * C * 1e6 / 1000.0)
    assert abs(speeds[0] / at_rest - 1) < 0.25 * (at_rest / across - 1)


@pytest.fixture(scope="module")
def measured() -> dict[str, np.ndarray]:
    """Forces and speeds of both orientations, without noise."""
    found = {}
    for name, axis in ALONG.items():
        curve = LawCurve(built(axis), LAW.along(axis), c=C, density_kg_per_m3=1000.0)
        found[name] = curve(SHAPE).values
        curve.close()
    return found


@pytest.fixture(scope="module")
def case_and_out(measured, tmp_path_factory) -> tuple[Case, Path]:
    """A case of two sites at one place, meshed with fibres along the limb."""
    root = tmp_path_factory.mktemp("fibres")
    folder, out = root / "case", root / "out"
    folder.mkdir()
    first = (
        sharp(block.CASE_TOML).replace('name = "p1"', 'name = "across"').replace("levels.csv", "across.csv")
    )
    (folder / "case.toml").write_text(first + sharp(SECOND))
    for name in ("skin.stl", "bone.stl"):
        (folder / name).write_text("solid empty\nendsolid empty\n")
    for name, axis in ALONG.items():
        forces, speeds = np.split(measured[name], 2)
        rest = np.exp(closed_form(SHAPE, np.array(axis)))
        rows = ["force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels", f"0,0,{rest:.9g},0.1,100"]
        rows += [f"{f:.9g},{d},{v:.9g},0.1,100" for f, d, v in zip(forces, DEPTHS, speeds, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join(rows) + "\n")
        with open_stage(out, "mesh", subject="B1", site=name) as writer:
            save_model(fibred(axis), writer.file("model", "model.npz"))
            writer.data["fibres"] = {"deviation_deg": 4.0 if name == "along" else None}
    case = Case.open(folder)
    build_feb(case, out=out)
    return case, out


@pytest.fixture(scope="module")
def both(case_and_out) -> StageResult:
    case, out = case_and_out
    return fit_joint(case, out=out, options=replace(OPTIONS, max_interval_solves=3))


@pytest.mark.slow
def test_two_orientations_give_back_one_tissue(both):
    data = both.data
    assert data["c_kpa"] == pytest.approx(6.0, rel=0.02)
    few_solves = (0.25, 0.05, 0.3)  # of m and the tension the data exclude only large values
    for name, value, rel in zip(("m", "fibre_shear", "fibre_tension"), SHAPE, few_solves, strict=True):
        assert data[name] == pytest.approx(value, rel=rel)
        low, high = data["interval_95"][name]
        assert low is None or low < value
        assert high is None or high > value
    assert data["mu_along_kpa"] == pytest.approx(6.0, rel=0.05)
    assert data["mu_across_kpa"] == pytest.approx(3.0, rel=0.02)
    assert data["f_kappa"] == FIBRE_F_KAPPA
    assert data["flags"]["fibre_shear"] == "identified"
    assert not any("orientation" in each or "all records" in each for each in both.warnings)
    assert any("linear tetrahedra lock" in each for each in both.warnings)
    assert not any("does not reproduce the data" in each for each in both.warnings)


@pytest.mark.slow
def test_what_a_doubtful_direction_changes_is_told(both):
    """Where the case states how well it is known: fibres 4 degrees off, against two simulations of that."""
    assert set(both.data["direction_uncertainty"]) == {"along"}
    found, values = both.data["direction_uncertainty"]["along"], []
    c, shape = 1e-3 * both.data["c_kpa"], np.array([both.data[each.name] for each in LAW.shape])
    a = np.radians(4.0)
    for axis in ((1.0, 0.0, 0.0), (np.cos(a), 0.0, np.sin(a))):
        curve = LawCurve(built(axis), LAW.along(axis), c=c, density_kg_per_m3=1000.0)
        values.append(curve(shape).values)
        curve.close()
    change = values[1] / values[0] - 1.0
    assert found["force_change_fraction"] == pytest.approx(change[:4][np.abs(change[:4]).argmax()], abs=2e-3)
    assert found["speed_change_fraction"] == pytest.approx(change[4:][np.abs(change[4:]).argmax()], abs=2e-3)


@pytest.mark.slow
def test_the_page_and_the_febio_file_hold_the_fibres(case_and_out, both):
    case, out = case_and_out
    text = report(case, out=out).path("page").read_text(encoding="utf-8")
    assert "fibre_shear" in text
    assert "The shear modulus across the fibres is" in text
    assert '<fiber type="vector"><vector>0,1,0</vector></fiber>' in both.path("material").read_text()
    assert read_feb(out / "build-feb" / "across" / "model.feb").fibres is not None


@pytest.mark.slow
def test_one_orientation_is_told_what_it_leaves_open(case_and_out, both):
    """After both, because it replaces their result: the interval of fibre_shear is wider by far."""
    case, out = case_and_out
    alone = fit_joint(case, out=out, sites=["across"], options=replace(OPTIONS, max_interval_solves=1))
    assert any("all records are across the fibres" in each for each in alone.warnings)
    assert any("with the probe turned by 90 degrees" in each for each in alone.warnings)

    def width(result: StageResult) -> float:
        low, high = result.data["interval_95"]["fibre_shear"]
        return np.log((high or LAW.shape[1].high) / (low or LAW.shape[1].low))

    assert width(alone) > 2.0 * width(both)


def test_words_of_orientations():
    assert not undetermined([0.02, 0.95], [True, True])
    assert ("one orientation only: fibre_shear is determined by forces") in undetermined(
        [0.02, 0.95], [True, False]
    )[0]
    assert "only the product c (1 + fibre_shear)" in undetermined([0.9, 0.95], [True, True])[0]
    assert "only a combination" in undetermined([0.5], [True])[0]
    assert share_along(fibred((0.6, 0.8, 0.0))) == pytest.approx(0.36)


def test_the_law_speaks_to_the_joint_fit_alone_and_is_known_by_name():
    with pytest.raises(CaseError, match="has no effect"):
        check_choice("force", FitOptions(law="fibres"))
    assert law_named("fibres") is LAW
    assert LAWS["ogden"].along((1.0, 0.0, 0.0)) is LAWS["ogden"]


@pytest.mark.slow
def test_forces_of_a_fit_are_those_of_fibres_that_jump():
    """Sheared fibres jump in where they begin to be stretched; those of a fit come in over a band."""
    model = built((0.3, 0.9, 0.3))
    shape = np.array([3.0, 0.9, 1.0])
    curve = LawCurve(model, LAW.along((0.3, 0.9, 0.3)), c=C, density_kg_per_m3=1000.0, speeds=False)
    found = curve(shape).values
    curve.close()
    law = model.with_material(TISSUE, LAW.along((0.3, 0.9, 0.3)).material(C, shape))
    jump, wide = (_forces(each) for each in (law, softer_jumps(law)))
    missed = np.abs(wide / jump - 1.0).max()
    assert missed > 5e-3
    assert np.abs(found / jump - 1.0).max() < 0.5 * missed


def _forces(model: LimbModel) -> np.ndarray:
    with ReferenceSession(model, threads=1, stalled=1e-3) as session:
        return session.solve().must_points.forces
