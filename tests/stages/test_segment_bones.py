"""A bone outside the skin is refused, or, where that is accepted, cut to what is inside."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case, Site, StatedNoise
from limbcli.errors import CaseError
from limbcli.imaging.surface import read_surface, write_surface
from limbcli.meshing.surfaces import Triangles
from limbcli.provenance.batch_memory import Memory
from limbcli.provenance.remaking_command import CommandStep
from limbcli.stages.check_geometry import geometry_findings
from limbcli.stages.segment import SegmentOptions, segment
from limbcli.surface_formats.aop import read_aop_limb
from tests.meshing.conftest import tube
from tests.stages.test_segment import case_with

pytestmark = pytest.mark.slow


def limb(folder: Path, *, fibula_at: float = 18.0, bones: tuple[str, ...] = ("tibia", "fibula")) -> Case:
    """A left leg of radius 40 mm with a fibula of radius 6 mm, `fibula_at` mm to the left of its axis."""
    x = fibula_at
    bodies = {
        "skin": tube((0, 0, -100), (0, 0, 100), (40, 40)),
        "tibia": tube((-8, -14, -104), (-8, -14, 104), (11, 11)),
        "fibula": tube((x, 2, -90), (x, 2, 90), (6, 6), around=24),
    }
    for name, each in bodies.items():
        write_surface(folder / f"{name}.ply", Triangles(each.points, each.faces))
    paths = tuple(folder / f"{name}.ply" for name in bones)
    return case_with(folder, skin=folder / "skin.ply", bones=paths)


def test_a_bone_outside_is_refused_with_its_distance_place_and_remedy(tmp_path):
    with pytest.raises(CaseError) as caught:
        segment(limb(tmp_path, fibula_at=70.0), out=tmp_path / "out")
    assert "100% of bone_fibula lies outside the skin, by up to 36 mm at [76.0, " in caught.value.what
    assert "in one frame" in caught.value.fix
    assert "limbcli segment CASE --accept-bones" in caught.value.fix
    assert not (tmp_path / "out" / "segment").exists()


def test_every_bone_outside_is_named(tmp_path):
    case = limb(tmp_path, fibula_at=70.0)
    patella = tube((0, -80, -20), (0, -80, 20), (15, 15))
    write_surface(tmp_path / "patella.ply", Triangles(patella.points, patella.faces))
    imaging = replace(case.imaging, bones=(*case.imaging.bones, tmp_path / "patella.ply"))
    with pytest.raises(CaseError) as caught:
        segment(replace(case, imaging=imaging), out=tmp_path / "out")
    assert "bone_fibula lies outside the skin, by up to 36 mm" in caught.value.what
    assert "bone_patella lies outside the skin, by up to 55 mm" in caught.value.what


def test_an_accepted_bone_outside_is_left_out_with_a_warning(tmp_path):
    case = limb(tmp_path, fibula_at=70.0)
    found = segment(case, out=tmp_path / "out", options=SegmentOptions(accept_bones=True))
    assert [name for name in found.files if name.startswith("bone_")] == ["bone_tibia"]
    (told,) = [each for each in found.warnings if "bone_fibula" in each]
    assert "by up to 36 mm" in told
    assert "it is left out (--accept-bones)" in told
    assert CommandStep.of(found).command(Path("limb"), Path("out")).endswith("--accept-bones")
    assert Memory(tmp_path / "out", case.subject).requested("segment", None) == {"accept_bones": True}


def test_of_an_accepted_bone_across_the_skin_the_part_inside_is_kept(tmp_path):
    found = segment(
        limb(tmp_path, fibula_at=40.0), out=tmp_path / "out", options=SegmentOptions(accept_bones=True)
    )
    bone = read_surface(found.path("bone_fibula"))
    assert bone.is_closed
    assert np.hypot(*bone.points[:, :2].T).max() < 40.3
    assert bone.volume == pytest.approx(0.5 * np.pi * 6.0**2 * 180.0, rel=0.1)
    (told,) = [each for each in found.warnings if "bone_fibula" in each]
    assert "only the part inside is kept" in told


def test_a_limb_without_any_bone_inside_is_refused_even_so(tmp_path):
    with pytest.raises(CaseError, match="no bone lies inside the skin"):
        segment(
            limb(tmp_path, fibula_at=70.0, bones=("fibula",)),
            out=tmp_path / "out",
            options=SegmentOptions(accept_bones=True),
        )


def test_bones_inside_are_the_same_accepted_or_not(tmp_path):
    """Also those that look out by less than counts, or beyond the limb's cut ends."""
    case = limb(tmp_path, fibula_at=35.5)  # 1.5 mm out
    plain, accepted = (
        segment(case, out=tmp_path / str(accept), options=SegmentOptions(accept_bones=accept))
        for accept in (False, True)
    )
    assert plain.warnings == accepted.warnings
    assert not any("outside" in each for each in plain.warnings)
    for name in ("bone_tibia", "bone_fibula"):
        assert plain.path(name).read_bytes() == accepted.path(name).read_bytes()


def test_check_says_where_a_site_has_other_than_two_bones(tmp_path):
    site = Site(
        name="p1", position=(0.0, 40.0, 0.0), marker=None, long_axis="transverse",
        levels=tmp_path / "levels.csv", trace=None, swe_maps=None, density_kg_per_m3=1000.0,
        noise=StatedNoise(),
    )  # fmt: skip
    both, one = limb(tmp_path), limb(tmp_path, bones=("tibia",))
    assert geometry_findings(replace(both, sites=(site,)), []) == ([], [])
    problems, (line,) = geometry_findings(replace(one, sites=(site,)), [])
    assert problems == []
    assert line.startswith("site p1: 1 bone at its height (bone_tibia); ")
    at_ankle = replace(site, position=(0.0, 40.0, -95.0))  # below the end of the fibula
    assert len(geometry_findings(replace(both, sites=(at_ankle,)), [])[1]) == 1


def test_the_skin_is_also_an_aop_on_request(tmp_path):
    found = segment(limb(tmp_path), out=tmp_path / "out", options=SegmentOptions(aop=True))
    written = read_aop_limb(found.path("aop"))
    assert written.side == "left"
    np.testing.assert_allclose(written.radii, 40.0, rtol=0.02)  # a prism of many sides
    assert np.ptp(written.heights) == pytest.approx(200.0, abs=1.1)
    assert CommandStep.of(found).command(Path("limb"), Path("out")).endswith("--aop")
    assert "aop" not in segment(limb(tmp_path), out=tmp_path / "out").files
