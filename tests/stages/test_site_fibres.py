"""Fibres of a site's model: from the case to the mesh, the model file, the effects and the page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from limbcli.case import Case
from limbcli.effects import effect
from limbcli.effects.tissue import fibre_direction, limb_axis
from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.feb.settings import schedule
from limbcli.feb.write import write_feb
from limbcli.model import ElementMap, LimbModel
from limbcli.model.npz_file import differences, load_model
from limbcli.results import read_result
from limbcli.site_model.element_fibres import DEFAULT_DIRECTION, with_fibres
from limbcli.site_model.indentation_model import indentation_model
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.solver import Simulation, Table
from limbcli.stages.check import check
from limbcli.stages.mesh import MeshRequest, mesh
from limbcli.stages.report import report
from limbcli.stages.running.vtu import write_step
from limbcli.stages.segment import segment
from tests.imaging.test_fibre_map import write as write_map
from tests.stages.block_case import block_model
from tests.stages.test_mesh import CASE, prism

pytestmark = pytest.mark.slow

TOLD = "fibre_direction = [0.1, 0.2, 2.0]\n"
SITE = 'levels = "levels.csv"\n'


def case_with(folder: Path, text: str = "", *, imaging: str = "") -> Case:
    """The prism case with one site, and this at its end."""
    one = CASE[: CASE.index('[[site]]\nname = "p2"')] + text
    (folder / "case.toml").write_text(
        one.replace('bones = ["tibia.ply"]\n', 'bones = ["tibia.ply"]\n' + imaging)
    )
    return Case.open(folder)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, Path]:
    """A case with a fibre direction, segmented and meshed."""
    folder, out = tmp_path_factory.mktemp("case"), tmp_path_factory.mktemp("out")
    for name, body in (("skin", prism(30.0, -60, 60)), ("tibia", prism(9.0, -70, 70, x=4.0))):
        meshio.Mesh(body.points, [("triangle", body.faces)]).write(folder / f"{name}.ply")
    (folder / "levels.csv").write_text("force_n,depth_mm\n0.5,0\n2,2\n")
    case = case_with(folder, TOLD)
    segment(case, out=out)
    mesh(case, out=out, options=MeshRequest(size=5.0, far_size=12.0))
    return folder, out


@pytest.fixture(scope="module")
def model(made) -> LimbModel:
    return load_model(read_result(made[1], "mesh", site="p1").path("model"))


def in_patient(model: LimbModel, axes: np.ndarray) -> np.ndarray:
    return axes @ np.array(model.info["patient_from_model"]).reshape(4, 4)[:3, :3].T


def test_a_direction_of_the_case_is_in_the_models_frame(made, model):
    axis = np.array([0.1, 0.2, 2.0]) / np.linalg.norm([0.1, 0.2, 2.0])
    assert model.fibres is not None
    assert len(model.fibres.values) == len(model.mesh.block("tissue").cells)
    np.testing.assert_allclose(
        in_patient(model, model.fibres.values), np.tile(axis, (len(model.fibres.values), 1))
    )
    data = read_result(made[1], "mesh", site="p1").data["fibres"]
    assert data["told"]
    np.testing.assert_allclose(np.abs(np.dot(data["mean_direction"], axis)), 1.0)


def test_the_model_file_keeps_them_and_febio_4_reads_the_attribute(model, tmp_path: Path):
    built = indentation_model(model, schedule([1.0, 2.0]), c=0.008, f_kappa=50.0, m=3.0)
    path = write_feb(built, tmp_path / "model.feb")
    text = path.read_text()
    assert '<ElementData name="fibres" elem_set="tissue" data_type="vec3">' in text
    assert not differences(built.fibres, read_feb(path).fibres)


def test_the_older_attribute_is_refused_as_by_febio_4(model, tmp_path: Path):
    path = write_feb(model, tmp_path / "model.feb")
    path.write_text(path.read_text().replace("data_type=", "datatype="))
    with pytest.raises(CaseError, match="datatype"):
        read_feb(path)


def test_a_law_with_fibres_refers_to_the_same_map(model, tmp_path: Path):
    varied = turned(model)
    fibred = effect("anisotropy").apply(varied, {"fibre_shear_per_c": 1.0, "fibre_tension_per_c": 0.5})
    path = write_feb(fibred, tmp_path / "model.feb")
    assert path.read_text().count('<ElementData name="fibres"') == 1
    assert '<fiber type="map"><map>fibres</map></fiber>' in path.read_text()
    mine, theirs = (each.materials["tissue"].parts[-1] for each in (fibred, read_feb(path)))
    assert not differences(mine.parameters["fiber"], theirs.parameters["fiber"])


def turned(model: LimbModel) -> LimbModel:
    """The same with fibres that turn with depth."""
    assert model.fibres is not None
    angle = 0.02 * model.mesh.points[model.mesh.block("tissue").cells].mean(axis=1)[:, 2]
    axes = np.stack([np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
    return replace(model, fibres=ElementMap("fibres", "tissue", axes))


def test_effects_take_the_told_direction_and_else_the_limb(model):
    constant = fibre_direction(model)
    assert isinstance(constant, tuple)
    np.testing.assert_allclose(constant, model.fibres.values[0])
    assert fibre_direction(turned(model)) is turned(model).fibres or isinstance(
        fibre_direction(turned(model)), ElementMap
    )
    assert fibre_direction(replace(model, fibres=None)) == limb_axis(model)
    for name, theta in (
        ("anisotropy", {"fibre_shear_per_c": 1.0, "fibre_tension_per_c": 0.5}),
        ("contraction", {"active_stress_per_c": 0.5}),
    ):
        part = effect(name).apply(model, theta).materials["tissue"].parts[-1]
        assert part.parameters["fiber"] == constant


def test_a_map_of_one_direction_gives_the_force_of_that_direction():
    """Twin: the same fibres as one vector, and cell by cell with signs at random."""
    base = indentation_model(block_model(), schedule([1.0, 2.0]), c=0.008, f_kappa=50.0, m=2.0)
    axis = np.array([0.6, 0.0, 0.8])
    n = len(base.mesh.block("tissue").cells)
    signs = np.random.default_rng(7).choice([-1.0, 1.0], n)[:, None]
    one = replace(base, fibres=ElementMap("fibres", "tissue", np.tile(axis, (n, 1))))
    many = replace(base, fibres=ElementMap("fibres", "tissue", signs * axis))
    forces = []
    for each in (one, many):
        fibred = effect("anisotropy").apply(each, {"fibre_shear_per_c": 1.0, "fibre_tension_per_c": 0.5})
        session = ReferenceSession(fibred)
        try:
            forces.append(session.solve().must_points.forces)
        finally:
            session.close()
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-5)


PENNATION = '[[site.pennation]]\norientation = "axial"\npennation_deg = 20.0\ndeviation_deg = 3.0\n'


def test_pennation_goes_deeper_towards_proximal(made, model):
    """At (0, 30, 0) the skin's normal is +y: deeper is -y, and the axial image's lateral is +z."""
    case = case_with(made[0], PENNATION)
    found, reported = with_fibres(case, case.sites[0], replace(model, fibres=None))
    axis = in_patient(model, found.fibres.values)[0]
    a = np.radians(20.0)
    np.testing.assert_allclose(axis * np.sign(axis[2]), [0.0, -np.sin(a), np.cos(a)], atol=0.01)
    assert reported.deviation_deg == 3.0


def limb_map(path: Path, *, shift: float = 0.0) -> None:
    """Directions along (0.6, 0, 0.8) in LPS in a box round the limb, moved by `shift` mm."""
    affine = np.diag([4.0, 4.0, 4.0, 1.0])
    affine[:3, 3] = np.array([-40.0, -40.0, -70.0]) + shift
    stored = np.zeros((20, 20, 35, 3))
    stored[...] = [-0.6, 0.0, 0.8]  # RAS
    write_map(path, stored, affine=affine)


def test_a_map_of_diffusion_mri_gives_every_element_its_axis(made, model):
    limb_map(made[0] / "v1.nii.gz")
    case = case_with(made[0], imaging='fibres = "v1.nii.gz"\n')
    found, reported = with_fibres(case, case.sites[0], replace(model, fibres=None))
    axes = in_patient(model, found.fibres.values)
    np.testing.assert_allclose(np.abs(axes @ [0.6, 0.0, 0.8]), 1.0, atol=1e-6)
    assert reported.facts["from_mean_share"] < 0.1
    assert not [each for each in check(made[0]).problems if "fibre" in each.what]


def test_a_map_outside_the_limb_is_refused(made, model):
    limb_map(made[0] / "v1.nii.gz", shift=200.0)
    case = case_with(made[0], imaging='fibres = "v1.nii.gz"\n')
    with pytest.raises(CaseError, match=r"has no data for 100 % of the tissue.*outside the limb"):
        with_fibres(case, case.sites[0], replace(model, fibres=None))


def test_check_names_a_map_of_four_components(made):
    write_map(made[0] / "v1.nii.gz", np.ones((4, 4, 4, 4)))
    case_with(made[0], imaging='fibres = "v1.nii.gz"\n')
    assert any("4 components, not 3" in each.what for each in check(made[0]).problems)


def test_nothing_told_leaves_the_model_as_it_is(made, model):
    case = case_with(made[0])
    plain = replace(model, fibres=None)
    found, reported = with_fibres(case, case.sites[0], plain)
    assert found is plain
    assert reported.source == DEFAULT_DIRECTION


def test_vtu_and_page_show_them_and_they_turn_with_the_tissue(made, model, tmp_path: Path):
    folder, out = made
    result = read_result(out, "mesh", site="p1")
    back = meshio.read(result.path("mesh"))
    tissue = next(k for k, each in enumerate(model.mesh.blocks) if each.name == "tissue")
    np.testing.assert_allclose(back.cell_data["fibre"][tissue], model.fibres.values)
    fields = tuple(f"F{a}{b}" for a in "xyz" for b in "xyz")
    n = len(model.mesh.block("tissue").cells)
    first = sum(len(each.cells) for each in model.mesh.blocks[:tissue])
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # about z by 90 degrees
    table = Table(fields, np.ones(1), first + np.arange(n), np.tile(2.0 * turn.ravel(), (1, n, 1)))
    step = Simulation("reference", "0", np.array([1.0]), {}, {}, {"elements.csv": table})
    write_step(model, step, 0, tmp_path / "step.vtu")
    turned_ = meshio.read(tmp_path / "step.vtu").cell_data["fibre"][tissue]
    np.testing.assert_allclose(turned_, model.fibres.values @ turn.T, atol=1e-12)
    case = case_with(folder, TOLD)
    text = report(case, out=out).path("page").read_text(encoding="utf-8")
    assert "Which way do the muscle fibres run?" in text
    assert "fibre_direction of the case" in text


def test_another_direction_makes_the_mesh_stale(made):
    folder, out = made
    case = case_with(folder, TOLD.replace("2.0", "1.0"))
    from limbcli.provenance.staleness import Chain

    with pytest.raises(CaseError, match="fibres of site p1 changed"):
        Chain(case, out).result("mesh", site="p1")
