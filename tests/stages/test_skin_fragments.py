"""The limb is the largest piece of the skin's file; others are named with size and place, and left out."""

from __future__ import annotations

from pathlib import Path

import pytest

from limbcli.errors import CaseError
from limbcli.imaging.surface import read_surface, write_surface
from limbcli.meshing.surfaces import Triangles, bodies, join
from limbcli.results import StageResult
from limbcli.stages.check_geometry import geometry_findings
from limbcli.stages.segment import segment
from limbcli.stages.segmenting.surfaces import read_body
from tests.meshing.conftest import cylinder
from tests.stages.test_segment import case_with


def written(path: Path, *bodies: Triangles) -> Path:
    whole = join(list(bodies))
    write_surface(path, Triangles(whole.points, whole.faces))
    return path


LIMB = cylinder(50.0, -100.0, 100.0)
BONES = (cylinder(10.0, -90.0, 90.0, (-15.0, 0.0)), cylinder(6.0, -90.0, 90.0, (20.0, 5.0)))


def case_of(folder: Path, *more: Triangles):
    files = [
        written(folder / f"{name}.ply", each) for name, each in zip(("tibia", "fibula"), BONES, strict=True)
    ]
    return case_with(folder, skin=written(folder / "skin.ply", LIMB, *more), bones=tuple(files))


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> StageResult:
    folder = tmp_path_factory.mktemp("alone")
    return segment(case_of(folder), out=folder / "out")


@pytest.mark.parametrize("size", [3.0, 12.5, 40.0])
def test_a_closed_fragment_behind_the_skin_is_left_out_and_named(
    alone: StageResult, tmp_path: Path, size: float
):
    case = case_of(tmp_path, cylinder(size, -size, size, (0.0, 70.0 + size)))
    result = segment(case, out=tmp_path / "out")
    skin, wanted = (read_surface(each.path("skin")) for each in (result, alone))
    assert len(skin.faces) == len(wanted.faces)
    assert skin.volume == pytest.approx(wanted.volume)
    (told,) = [each for each in result.warnings if "left out" in each]
    assert f"a piece {2 * size:.0f} mm across at" in told
    assert f"{70 + size:.0f}"[:2] in told
    assert not any("left out" in each for each in alone.warnings)


def test_check_names_the_fragment_too(tmp_path: Path):
    case = case_of(tmp_path, cylinder(12.5, -12.5, 12.5, (0.0, 82.5)))
    found, _ = geometry_findings(case, [])
    assert any("1 more piece outside its largest" in each.what for each in found)
    assert not any(each.severity == "error" for each in found)


def test_a_bone_in_another_piece_than_the_limb_is_an_error_that_names_both(tmp_path: Path):
    other = cylinder(45.0, -90.0, 90.0, (150.0, 0.0))
    bone = written(tmp_path / "fibula.ply", cylinder(8.0, -80.0, 80.0, (150.0, 0.0)))
    case = case_with(
        tmp_path,
        skin=written(tmp_path / "skin.ply", LIMB, other),
        bones=(written(tmp_path / "tibia.ply", BONES[0]), bone),
    )
    with pytest.raises(CaseError, match=r"bone_fibula lies in a piece 180 mm across at .*150"):
        segment(case, out=tmp_path / "out")


def test_a_skin_read_alone_leaves_fragments_out_too(tmp_path: Path):
    path = written(tmp_path / "skin.ply", LIMB, cylinder(12.5, -12.5, 12.5, (0.0, 82.5)))
    skin, warnings = read_body(path)
    assert len(bodies(skin)) == 1
    assert any("left out" in each for each in warnings)


def test_a_body_inside_the_skin_stays_in_its_file(tmp_path: Path):
    path = written(tmp_path / "skin.ply", LIMB, BONES[0], cylinder(5.0, -5.0, 5.0, (0.0, 90.0)))
    assert len(bodies(read_body(path)[0])) == 2


def test_bones_that_the_skin_s_file_holds_too_are_left_out_of_it(alone: StageResult, tmp_path: Path):
    """They share the points of a cut with the skin, and would be one body with it."""
    touching = Triangles(BONES[0].points.copy(), BONES[0].faces)
    touching.points[touching.points[:, 2].argmax()] = LIMB.points[LIMB.points[:, 2].argmax()]
    case = case_of(tmp_path, touching, BONES[1])
    written(tmp_path / "tibia.ply", touching)
    result = segment(case, out=tmp_path / "out")
    volumes = result.data["volume_cm3"]
    assert volumes["skin"] == pytest.approx(alone.data["volume_cm3"]["skin"])
    assert [each for each in result.warnings if "also holds bone_tibia and bone_fibula" in each]
