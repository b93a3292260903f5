"""The mesh stage and its command on a small case made of surfaces."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np
import pytest

from limbcli.case import Case
from limbcli.cli.app import main
from limbcli.errors import CaseError
from limbcli.errors.problems import errors_of
from limbcli.meshing.anatomy import limb_problems
from limbcli.meshing.checks import LayersKept, SiteChecks
from limbcli.meshing.surfaces import Triangles
from limbcli.model.npz_file import load_model
from limbcli.results import StageResult, read_result
from limbcli.site_model.mesh_checks import (
    geometry_warnings,
    layer_warnings,
    moved_warnings,
    warnings_now,
)
from limbcli.stages.mesh import MeshRequest, mesh
from limbcli.stages.segment import segment
from limbcli.stages.segmenting.surfaces import read_surfaces

CASE = """format = 1
[subject]
id = "S1"
limb = "left"
[imaging]
skin = "skin.ply"
bones = ["tibia.ply"]
[probe]
name = "small"
length_mm = 30.0
width_mm = 12.0
edge_radius_mm = 2.0
[model]
margin_mm = 20.0
element = "tet4"
[[site]]
name = "p1"
position_mm = [0.0, 29.5, 0.0]
long_axis = "transverse"
levels = "levels.csv"
[[site]]
name = "p2"
marker = 3
long_axis = "axial"
levels = "levels.csv"
"""


def prism(
    radius: float, low: float, high: float, *, x: float = 0.0, n: int = 36, along: int = 24
) -> Triangles:
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    z = np.linspace(low, high, along)
    rings = [np.c_[x + radius * np.cos(t), radius * np.sin(t), np.full(n, h)] for h in z]
    points = np.vstack([*rings, [[x, 0, low]], [[x, 0, high]]])
    faces = []
    for k in range(along - 1):
        for i in range(n):
            a, b = k * n + i, k * n + (i + 1) % n
            faces += [(a, b, b + n), (a, b + n, a + n)]
    m, top = along * n, (along - 1) * n
    faces += [(m, (i + 1) % n, i) for i in range(n)] + [(m + 1, top + i, top + (i + 1) % n) for i in range(n)]
    return Triangles(points, np.array(faces, np.int64))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("case")
    for name, body in (("skin", prism(30.0, -60, 60)), ("tibia", prism(9.0, -70, 70, x=4.0))):
        meshio.Mesh(body.points, [("triangle", body.faces)]).write(folder / f"{name}.ply")
    (folder / "levels.csv").write_text("force_n,depth_mm\n0.5,0\n2,2\n")
    (folder / "case.toml").write_text(CASE)
    return folder


@pytest.fixture(scope="module")
def out(folder, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("out")
    segment(Case.open(folder), out=out)
    mesh(Case.open(folder), out=out, sites=["p1"], options=MeshRequest(size=4.0, far_size=10.0))
    return out


@pytest.mark.drawn
def test_stage_leaves_model_picture_and_figures(out):
    result = read_result(out, "mesh", site="p1")
    assert set(result.files) == {"model", "mesh", "picture", "fibre_picture"}
    assert all(result.path(name).stat().st_size > 1000 for name in result.files)
    assert result.data["quality"]["min_angle_deg"] > 4
    assert result.data["checks"]["skin_bone_mm"] == pytest.approx(30 - 9 * np.sqrt(1 - (4 / 9) ** 2), abs=0.6)
    assert result.provenance["inputs_sha256"]["skin.ply"]


def test_model_comes_back_from_its_file(out):
    model = load_model(read_result(out, "mesh", site="p1").path("model"))
    assert model.mesh.block("tissue").kind == "tet4"
    patient = np.array(model.info["patient_from_model"]).reshape(4, 4)
    skin = model.mesh.points[model.mesh.node_sets["skin"]] @ patient[:3, :3].T + patient[:3, 3]
    assert np.hypot(skin[:, 0], skin[:, 1]) == pytest.approx(np.full(len(skin), 30.0), abs=0.4)


def test_vtu_carries_every_set(out):
    result = read_result(out, "mesh", site="p1")
    model, back = load_model(result.path("model")), meshio.read(result.path("mesh"))
    for name, nodes in model.mesh.node_sets.items():
        assert (np.flatnonzero(back.point_data[f"set_{name}"]) == np.sort(nodes)).all()
    assert {f"surface_{name}" for name in model.mesh.surfaces} <= set(back.point_data)
    assert {"block", "min_dihedral_deg", "block_tissue", "block_probe"} <= set(back.cell_data)


def test_marker_that_was_not_found_is_an_error(folder, out):
    with pytest.raises(CaseError, match="marker 3 was not found") as caught:
        mesh(Case.open(folder), out=out, sites=["p2"])
    assert "position_mm" in caught.value.fix


@pytest.mark.slow
def test_a_long_axis_far_out_of_the_skin_is_told(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "rough")
    text = CASE.replace('long_axis = "transverse"', "long_axis = [1.0, 0.5, 0.0]")
    (tmp_path / "rough" / "case.toml").write_text(text)
    case = Case.open(tmp_path / "rough")
    segment(case, out=tmp_path / "out")
    (result,) = mesh(case, out=tmp_path / "out", sites=["p1"], options=MeshRequest(size=6.0, far_size=15.0))
    assert result.data["frame"]["long_axis_slope_deg"] == pytest.approx(26.6, abs=0.1)
    assert any("leaves the skin by 27 degrees" in each for each in result.warnings)


@pytest.mark.slow
def test_a_place_that_was_corrected_is_not_told_as_it_was(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "case")
    (tmp_path / "case" / "case.toml").write_text(CASE.replace("29.5", "41.5"))
    before = segment(Case.open(tmp_path / "case"), out=tmp_path / "out")
    assert any("site p1 lies" in each for each in before.warnings)
    (tmp_path / "case" / "case.toml").write_text(CASE)
    (result,) = mesh(
        Case.open(tmp_path / "case"),
        out=tmp_path / "out",
        sites=["p1"],
        options=MeshRequest(size=6.0, far_size=15.0),
    )
    assert not any("site p1 lies" in each for each in result.warnings)


def test_sizes_out_of_range_are_refused(folder, out):
    with pytest.raises(CaseError, match="--size-mm"):
        mesh(Case.open(folder), out=out, sites=["p1"], options=MeshRequest(size=0.1))


def test_without_segment_it_says_what_to_run(folder, tmp_path):
    with pytest.raises(CaseError, match="no result of `segment`"):
        mesh(Case.open(folder), out=tmp_path)


def test_drawn_bodies_whose_triangles_span_the_limb_are_a_limb(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "drawn")
    for name, body in (
        ("skin", prism(30.0, -60.0, 60.0, along=2)),
        ("tibia", prism(8.0, -60.0, 60.0, along=2)),
    ):
        meshio.write(tmp_path / "drawn" / f"{name}.ply", meshio.Mesh(body.points, [("triangle", body.faces)]))
    surfaces = read_surfaces(Case.open(tmp_path / "drawn"))[0]
    assert errors_of(limb_problems(surfaces, limb="left", where="drawn")) == []
    assert surfaces["skin"].volume == pytest.approx(prism(30.0, -60.0, 60.0).volume)
    corners = surfaces["skin"].corners
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 25.0


def test_scans_stay_as_they_were_given_though_their_flat_ends_are_of_long_triangles(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "scan")
    around, up = np.meshgrid(np.arange(36), np.arange(25))
    angle, height = 2 * np.pi * around.ravel() / 36, -60.0 + 5.0 * up.ravel()
    points = np.stack([30.0 * np.cos(angle), 30.0 * np.sin(angle), height], axis=1)
    a = (36 * up[:-1] + around[:-1]).ravel()
    b = (36 * up[:-1] + (around[:-1] + 1) % 36).ravel()
    end = np.stack([np.zeros(34), np.arange(1, 35), np.arange(2, 36)], axis=1)
    faces = np.vstack([np.c_[a, b, b + 36], np.c_[a, b + 36, a + 36], end[:, ::-1], end + 36 * 24])
    meshio.write(tmp_path / "scan" / "skin.ply", meshio.Mesh(points, [("triangle", faces.astype(int))]))
    skin = read_surfaces(Case.open(tmp_path / "scan"))[0]["skin"]
    edges = np.linalg.norm(skin.points[skin.faces] - skin.points[np.roll(skin.faces, 1, 1)], axis=2)
    assert edges.max() > 50.0
    assert len(skin.faces) == len(faces)


@pytest.mark.slow
def test_layers_and_place_by_angle_and_height(folder, out, tmp_path):
    shutil.copytree(out / "segment", tmp_path / "segment")
    case = Case.open(folder)
    result = mesh(
        case,
        out=tmp_path,
        sites=["p1"],
        options=MeshRequest(size=4, far_size=10, fat_layer=4.0, place=(90.0, 60.0)),
    )[0]
    assert result.data["frame"]["skin_point_mm"] == pytest.approx([30, 0, 0], abs=0.6)
    model = load_model(result.path("model"))
    assert [each.name for each in model.mesh.solid_blocks] == ["tissue", "fat"]
    assert result.data["layers_made"]["at_centre"]["fat_mm"] == pytest.approx(4.0, abs=0.15)
    with pytest.raises(CaseError, match="several sites"):
        mesh(case, out=tmp_path, options=MeshRequest(place=(90.0, 60.0)))
    with pytest.raises(CaseError, match="--at is"):
        mesh(case, out=tmp_path, sites=["p1"], options=MeshRequest(place=(90.0, float("inf"))))


def checks(**changes: float | None) -> SiteChecks:
    usual = {
        "skin_bone_mm": 20.0, "thinnest_under_probe_mm": 18.0, "over_tissue_share": 1.0, "bone_share": 1.0,
        "to_cut_mm": 40.0, "gap_at_first_touch_mm": 1.0,
    }  # fmt: skip
    return SiteChecks(**{**usual, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("found", "measured", "message"),
    [
        (checks(), 20.5, None),
        (checks(), None, None),
        (checks(), 23.0, "23.0 mm on the B-mode image (-13 %)"),
        (checks(skin_bone_mm=None), 23.0, "the model has none"),
        (checks(over_tissue_share=0.8), None, "80 % of the probe face"),
        (checks(to_cut_mm=20.0), None, "end 20 mm beyond the probe"),
    ],
)
def test_model_is_checked_against_the_measurement(found, measured, message):
    warnings = geometry_warnings(found, measured=measured, margin=40.0, site="p1")
    assert [message in each for each in warnings] == ([True] if message else [])


def test_layers_that_thin_out_over_bone_are_told_with_what_is_left():
    assert layer_warnings(LayersKept(centre=1.0, least=0.95), 7.5) == []
    (message,) = layer_warnings(LayersKept(centre=0.8, least=0.72), 7.5)
    assert "5.4 mm are left under the probe, 6.0 mm at its centre" in message


def test_a_place_beside_the_skin_is_told_and_the_middle_of_a_marker_is_none():
    assert moved_warnings(2.0, SimpleNamespace(marker=None)) == []
    assert moved_warnings(4.0, SimpleNamespace(marker=3)) == []
    (said,) = moved_warnings(4.0, SimpleNamespace(marker=None))
    assert "was 4.0 mm from the skin" in said


def test_a_mesh_is_told_with_the_bones_depth_of_today(tmp_path):
    """Levels may be read after the mesh was made, or corrected: what is said of the mesh goes with them."""
    site = SimpleNamespace(levels=tmp_path / "levels.csv", skin_bone=None)

    def current_warnings(then: float | None, now: float | None) -> list[str]:
        warnings = ("a voxel is large", *geometry_warnings(checks(), measured=then, margin=40.0, site="p1"))
        data = {"checks": {"skin_bone_mm": checks().skin_bone_mm}, "measured_skin_bone_mm": then}
        head = "force_n,depth_mm,skin_bone_mm" if now else "force_n,depth_mm"
        rows = [f"{2 * k},{k},{now - k}" if now else f"{2 * k},{k}" for k in range(3)]
        site.levels.write_text("\n".join([head, *rows]) + "\n")
        return warnings_now(StageResult("mesh", "S1", Path(), warnings=warnings, data=data), site)

    depths = ((None, 23.0), (23.0, 23.0), (23.0, 20.5), (23.0, None))
    assert [len(current_warnings(*each)) for each in depths] == [
        2,
        2,
        1,
        1,
    ]


@pytest.mark.slow
def test_command_prints_json(folder, out, capsys):
    with pytest.raises(SystemExit) as done:
        main(
            [
                "mesh",
                str(folder),
                "--out",
                str(out),
                "--site",
                "p1",
                "--size-mm",
                "5",
                "--far-size-mm",
                "12",
                "--json",
                "-q",
            ]
        )
    assert not done.value.code
    printed = json.loads(capsys.readouterr().out)
    assert printed[0]["stage"] == "mesh"
    assert printed[0]["data"]["size_under_probe_mm"] == 5.0
