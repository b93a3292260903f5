"""`limbcli limb`: its files, what it refuses, and what its result says."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

import limbcli
from limbcli.case import Case
from limbcli.errors import CaseError
from limbcli.feb.read import read_feb
from limbcli.fem.analysis import Analysis
from limbcli.meshing.surfaces import Triangles, read_surface
from limbcli.meshing.whole_limb import LimbMesh, limb_mesh
from limbcli.model import Curve, ElementMap, Step, Support
from limbcli.model.npz_file import load_model
from limbcli.results import read_result
from limbcli.stages import limb as stage
from limbcli.stages.limb import LimbOptions, limb
from limbcli.stages.limb_field.case_field import CaseField
from limbcli.stages.limb_field.site_results import LimbReadings
from limbcli.stages.limb_model.hand_over import _force_in_words
from limbcli.stages.segment import SegmentOptions, segment
from limbcli.stiffness_field import Interval, SiteReading, stiffness_field
from limbcli.surface_formats.aop import read_aop_limb
from tests.meshing.stump import quickly_meshed, stump

pytestmark = pytest.mark.slow
OPTIONS = LimbOptions(nodes=5_000, c_kpa=8.0)
SITE = """
[probe]
name = "small"
length_mm = 20.0
width_mm = 10.0
edge_radius_mm = 3.0
[[site]]
name = "p1"
position_mm = [0.0, 40.0, 80.0]
long_axis = "transverse"
levels = "levels.csv"
[site.layers]
fat = {thickness_mm = 4.0}
"""


def write_case(folder: Path, surfaces=None, more: str = "") -> Case:
    """A case of these surfaces (a stump's); more : further text of case.toml."""
    (folder / "s").mkdir(parents=True)
    surfaces = surfaces or stump()
    for name, each in surfaces.items():
        meshio.Mesh(each.points, [("triangle", each.faces.astype(np.int32))]).write(
            folder / "s" / f"{name}.ply"
        )
    bones = ", ".join(f'"s/{name}.ply"' for name in surfaces if name != "skin")
    text = 'format = 1\n[subject]\nid = "S1"\nlimb = "left"\n[imaging]\nskin = "s/skin.ply"\n'
    text += f"bones = [{bones}]\n"
    (folder / "case.toml").write_text(text + more)
    rows = ["force_n,depth_mm,swe_mean_m_per_s", "0,0,2.0", "1,2,", "2,4,"]
    (folder / "levels.csv").write_text("\n".join(rows) + "\n")
    return Case.open_images(folder)


@pytest.fixture(scope="module", autouse=True)
def quick():
    with pytest.MonkeyPatch.context() as patch:
        quickly_meshed(patch)
        yield


@pytest.fixture(scope="module")
def meshes() -> list[LimbMesh]:
    """Of `made`, for tests that ask no more of a mesh."""
    return []


@pytest.fixture(scope="module")
def made(tmp_path_factory, meshes):
    def meshed(*given, **options):
        meshes.append(limb_mesh(*given, **options))
        return meshes[-1]

    folder = tmp_path_factory.mktemp("limb")
    case = write_case(folder / "case")
    segment(case, out=folder / "out")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage, "limb_mesh", meshed)
        return case, folder / "out", limb(case, out=folder / "out", options=OPTIONS)


@pytest.mark.drawn
def test_the_model_file_is_read_back_as_the_stored_model(made):
    result = made[2]
    model, stored = read_feb(result.path("feb")), load_model(result.path("model"))
    assert np.array_equal(model.mesh.points, stored.mesh.points)
    assert set(model.mesh.surfaces) == set(stored.mesh.surfaces)
    assert {body.name for body in model.bodies} == {"tibia", "fibula", "femur", "patella"}
    c1, kappa = (model.materials["tissue"].parameters[name] for name in ("c1", "kappa"))
    assert isinstance(c1, ElementMap)
    assert isinstance(kappa, ElementMap)
    assert c1.values == pytest.approx(0.004)
    assert kappa.values == pytest.approx(0.8)


def test_an_unloaded_limb_is_at_rest_for_febio_although_forces_are_rounded(made):
    """6,233 nodes leave a sum of squares of 4e-20 N^2 in FEBio 4.11, whose own limit is 1e-20; a force that
    matters is larger than 1e-6 N."""
    limit = float(read_feb(made[2].path("feb")).steps[0].control["min_residual"])
    assert 1e-18 < limit < 1e-12


def test_the_file_solves_with_a_small_load(made):
    """The distal end pulled by 0.2 mm: it moves, the bones do not, and nothing moves farther."""
    model = read_feb(made[2].path("feb"))
    pulled = np.unique(model.mesh.surfaces["patch_distal_end"].facets["tri6"])
    mesh = replace(model.mesh, node_sets={**model.mesh.node_sets, "pulled": pulled})
    loaded = replace(
        model,
        mesh=mesh,
        supports=(*model.supports, Support("pulled", ("z",), -0.2, "load")),
        curves={"load": Curve(((0.0, 0.0), (1.0, 1.0)))},
        steps=(Step(n_steps=1, step_size=1.0),),
    )
    analysis = Analysis(loaded)
    states = analysis.run()
    moved = states[-1].state.u
    assert moved[pulled, 2] == pytest.approx(-0.2)
    inside = np.setdiff1d(np.arange(len(mesh.points)), pulled)
    assert np.abs(moved[inside]).max() < 0.25
    assert np.abs(moved[mesh.node_sets["bone_tibia"]]).max() == pytest.approx(0.0, abs=1e-12)


def test_files_for_others(made):
    result = made[2]
    grid = meshio.read(result.path("mesh"))
    assert grid.cell_data["c_kpa"][0] == pytest.approx(8.0)
    assert set(grid.cell_data["label"][0]) == {2.0}
    assert np.isnan(grid.cell_data["distance_mm"][0]).all()
    skin, bones = (read_surface(result.path(name)) for name in ("skin", "bones"))
    assert skin.areas.sum() > 2 * np.pi * 40 * 110
    assert bones.volume > 0, "normals out of the bone"
    text = result.path("readme").read_text()
    assert "LPS" in text
    assert "MPa" in text
    assert "not good for" in text
    with result.path("parts").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["name"] for row in rows if row["kind"] == "patch"} >= {
        "distal_end",
        "popliteal",
        "tibial_crest",
    }


def with_field(monkeypatch, c_of: dict[str, float]) -> None:
    """Let sites of these c (MPa), one at the front and one at the back, tell the stiffness."""

    def field_of(case, chain, limb, writer, **_):
        places = {"p1": [0.0, -35.0, 60.0], "p2": [0.0, 35.0, 60.0]}
        sites = [
            SiteReading(
                name,
                np.array([places[name]]),
                {"c": Interval(c, 0.9 * c, 1.1 * c), "m": Interval(m, 0.9 * m, 1.1 * m)},
                source="fit",
            )
            for (name, c), m in zip(c_of.items(), (2.0, 6.0), strict=True)
        ]
        field = stiffness_field(limb, sites, [])
        return CaseField(field, LimbReadings(sites))

    monkeypatch.setattr(stage, "case_field", field_of)


def test_elements_have_the_values_of_the_field_and_a_draw_its_own_model(made, meshes, tmp_path, monkeypatch):
    case, out, _ = made
    shutil.copytree(out / "segment", tmp_path / "segment")
    with_field(monkeypatch, {"p1": 0.004, "p2": 0.012})
    monkeypatch.setattr(stage, "limb_mesh", lambda *_, **__: meshes[0])
    found = limb(case, out=tmp_path, options=LimbOptions(nodes=5_000, draws=(3,)))
    grid = meshio.read(found.path("mesh"))
    c, low, high, label = (grid.cell_data[name][0] for name in ("c_kpa", "c_low_kpa", "c_high_kpa", "label"))
    middle = grid.points[grid.cells[0].data[:, :4]].mean(axis=1)
    near = [np.linalg.norm(middle - place, axis=1).argmin() for place in ([0, -35, 60], [0, 35, 60])]
    assert c[near[0]] == pytest.approx(4.0, rel=0.25)
    assert c[near[1]] == pytest.approx(12.0, rel=0.25)
    assert np.all((low < c) & (c < high))
    assert label[near].tolist() == [0.0, 0.0]
    assert (label != 0.0).any()
    model, drawn = read_feb(found.path("feb")), read_feb(found.path("feb_draw_03"))
    own = model.materials["tissue"].parameters["c1"].values
    assert own == pytest.approx(c / 2000.0, rel=1e-6)
    m = model.materials["tissue"].parameters["m1"].values
    assert m[near] == pytest.approx([2.0, 6.0], rel=0.25)
    assert model.materials["tissue"].parameters["m2"].values == pytest.approx(-m, rel=1e-6)
    assert grid.cell_data["m"][0] == pytest.approx(m, rel=1e-6)
    other = drawn.materials["tissue"].parameters["c1"].values
    assert np.std(np.log(other / own)) > 0.01
    with found.path("draws").open() as stream:
        assert len(list(csv.DictReader(stream))) == 50
    assert "site p2: c = 12 kPa, from fit" in found.path("readme").read_text()
    assert any("identified" in line for line in found.summary)
    with pytest.raises(CaseError, match="draw 50 cannot be written: there are draws 0 to 49"):
        limb(case, out=tmp_path, options=LimbOptions(nodes=5_000, draws=(3, 50)))


def test_one_stiffness_for_all_has_no_draws(made, tmp_path):
    shutil.copytree(made[1] / "segment", tmp_path / "segment")
    with pytest.raises(CaseError, match="has no draws"):
        limb(made[0], out=tmp_path, options=replace(OPTIONS, draws=(0,)))


def test_abaqus_and_aop_have_the_same_limb(made):
    result = made[2]
    text = result.path("inp").read_text()
    n_nodes = text.upper().partition("*NODE")[2].partition("*ELEMENT")[0].count("\n") - 1
    assert n_nodes >= result.data["n_nodes"]
    assert "C3D10H" in text
    shape = read_aop_limb(result.path("aop"))
    assert shape.side == "left"
    assert np.median(shape.radii) == pytest.approx(40.0, abs=10.0)


def test_bones_are_fixed_and_the_cut_is_held(made):
    model = load_model(made[2].path("model"))
    assert {(each.body, each.dof) for each in model.drives} == {
        (body.name, dof) for body in model.bodies for dof in "xyzuvw"
    }
    assert model.supports[0].node_set == "held"
    assert model.info["frame"]["axis_lps"] == pytest.approx([0, 0, 1], abs=0.02)


def test_a_change_of_the_surfaces_makes_the_result_stale(made, tmp_path):
    from limbcli.provenance.staleness import Chain

    case, out, result = made
    assert Chain(case, out).broken(read_result(out, "limb")) is None
    other = write_case(
        tmp_path / "other",
        {**stump(), "skin": Triangles(stump()["skin"].points * 1.01, stump()["skin"].faces)},
    )
    broken = Chain(other, out).broken(result)
    assert broken is not None
    assert "limbcli limb" in broken.fix(other, out)


def test_fat_of_a_site_is_a_conforming_layer_and_c_that_of_speed_at_rest(tmp_path):
    case = write_case(tmp_path / "case", more=SITE)
    segment(case, out=tmp_path / "out")
    found = limbcli.limb(case, out=tmp_path / "out", nodes=8_000, site_size_mm=3.0)
    model = found.model()
    assert [each.name for each in model.mesh.solid_blocks] == ["tissue", "fat"]
    shared = np.intersect1d(*(each.cells for each in model.mesh.solid_blocks))
    assert len(shared) > 100, "both blocks have the nodes of the border"
    assert found.c_kpa == pytest.approx(8.0)  # 2 rho v2
    assert "site p1" in found.data["stiffness"]["source"]
    assert "site_p1" in model.mesh.node_sets
    inner = Triangles(model.mesh.points, next(iter(model.mesh.surfaces["skin"].facets.values()))[:, :3])
    near = np.linalg.norm(inner.centroids - [0.0, 40.0, 80.0], axis=1) < 6.0
    assert np.sqrt(inner.areas[near].mean()) < 0.6 * np.sqrt(inner.areas.mean()), "finer under the probe"


def test_without_segment_without_stiffness_and_with_a_wrong_option(tmp_path, made):
    case = write_case(tmp_path / "case")
    with pytest.raises(CaseError, match="no result of `segment`"):
        limb(case, out=tmp_path / "out", options=OPTIONS)
    with pytest.raises(CaseError, match="--nodes is 10"):
        limb(made[0], out=made[1], options=replace(OPTIONS, nodes=10))
    with pytest.raises(CaseError, match=r"c is 9000 kPa"):
        limbcli.limb(made[0], out=made[1], c_kpa=9000.0, nodes=5_000)
    with pytest.raises(CaseError, match="there is none: c is given by hand"):
        limbcli.limb(made[0], out=made[1], c_kpa=8.0, cohort=tmp_path, nodes=5_000)
    with pytest.raises(CaseError, match="location is given without a cohort"):
        limbcli.limb(made[0], out=made[1], cohort_location="LL_P", nodes=5_000)
    with pytest.raises(CaseError, match="no probe to mesh for"):
        limb(made[0], out=made[1], options=replace(OPTIONS, site_size=3.0))


def test_a_limb_without_sites_needs_a_stiffness_by_hand(made):
    """A fit, which was proposed, is not possible there."""
    case = replace(made[0], sites=())
    with pytest.raises(CaseError, match="there is no site") as caught:
        limb(case, out=made[1], options=LimbOptions(nodes=5_000))
    assert caught.value.fix.startswith(
        "add a [[site]] and fit it, or give the stiffness by hand: `limb --c-kpa`"
    )


def test_a_bone_through_the_skin_is_refused(tmp_path):
    surfaces = stump()
    out_of_it = Triangles(surfaces["bone_tibia"].points - [0, 40, 0], surfaces["bone_tibia"].faces)
    case = write_case(tmp_path / "case", {**surfaces, "bone_tibia": out_of_it})
    with pytest.raises(CaseError, match="outside the skin"):
        segment(case, out=tmp_path / "out")
    segment(case, out=tmp_path / "out", options=SegmentOptions(accept_bones=True))


def test_the_mean_limb_of_openlimb(shared: Path, tmp_path: Path):
    """A transtibial limb with all four bones: every patch is there, and the mesh is sound."""
    path = shared / "data" / "openlimb" / "Mean_Limb_Shape.stl"
    if not path.is_file():
        pytest.skip(f"needs {path}")
    surface = read_surface(path)
    (tmp_path / "case").mkdir()
    in_mm = meshio.Mesh(surface.points * 380.0, [("triangle", surface.faces.astype(np.int32))])
    in_mm.write(tmp_path / "case" / "limb.ply")
    text = 'format = 1\n[subject]\nid = "S1"\nlimb = "right"\n[imaging]\nskin = "limb.ply"\n'
    (tmp_path / "case" / "case.toml").write_text(text)
    case = Case.open_images(tmp_path / "case")
    segment(case, out=tmp_path / "out")
    result = limb(case, out=tmp_path / "out", options=LimbOptions(c_kpa=8.0, nodes=8_000))
    assert not result.data["missing_parts"]
    assert result.data["quality"]["min_angle_deg"] > 4
    assert result.data["volume_cm3"] == pytest.approx(result.data["expected_volume_cm3"], rel=0.01)


def test_the_leg_of_the_visible_human(shared: Path, tmp_path: Path):
    """Cut at the ankle and in the thigh: meshed with its distal cut if asked."""
    folder = shared / "data" / "visible-human-leg"
    if not folder.is_dir():
        pytest.skip(f"needs {folder}")
    names = {"skin": "skin_leg_5p0_mm", **{f"bone_{n}": n for n in ("femur", "tibia", "fibula", "patella")}}
    surfaces = {name: read_surface(folder / f"VHF_right_{file}.obj") for name, file in names.items()}
    case = write_case(tmp_path / "case", surfaces)
    segment(case, out=tmp_path / "out")
    options = LimbOptions(c_kpa=8.0, distal_cut=True, element="tet4", nodes=4_000)
    result = limb(case, out=tmp_path / "out", options=options)
    assert "distal_end" in result.data["missing_parts"]
    assert {"patch_patellar_tendon", "patch_popliteal", "distal_cut"} <= set(result.data["surfaces"])


def test_the_readme_tells_what_the_limb_gives_of_a_sites_force():
    assert _force_in_words({"force_on_limb": 1.004, "limb_over_site": 0.9}).endswith(
        "100.4 % of the fit's force (simulated)"
    )
    assert "90 % of the force of the site's model" in _force_in_words(
        {"force_on_limb": None, "limb_over_site": 0.9}
    )
    assert _force_in_words({"c_kpa": [8.0, 7.0, 9.0]}) == ""
