"""A limb without MRI: surfaces by its numbers, the same chain, intervals that allow for what is assumed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.diagnosis.mesh_error.numerical_checks import USUAL_GAIN, assumed_gain
from limbcli.errors import CaseError
from limbcli.fitting.geometry import NOT_ALLOWED_FOR
from limbcli.fitting.geometry_variations import depth_deviation
from limbcli.imaging.surface import read_surface, write_surface
from limbcli.meshing.frame import closest_on_triangles
from limbcli.meshing.rods import Rod, tube
from limbcli.meshing.surfaces import Triangles
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.provenance.staleness import Chain
from limbcli.results import read_result
from limbcli.stages.build_feb import build_feb
from limbcli.stages.check import check
from limbcli.stages.fit import FitOptions, fit
from limbcli.stages.fit_joint import fit_joint
from limbcli.stages.mesh import MeshRequest, mesh
from limbcli.stages.report import report
from limbcli.stages.run import run
from limbcli.stages.segment import segment
from limbcli.stages.segmenting.assumed_geometry import assumed_limb
from limbcli.stages.simulated_subjects.indent import KnownTissue
from limbcli.stages.simulated_subjects.synth_options import SynthOptions
from limbcli.stages.synth import synth

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse")]

SHAPE = "shape = { circumference_mm = 200, skin_mm = 1.5, fat_mm = 4.5, muscle_mm = 9, bone_radius_mm = 9 }"
SCAN = 'skin = "skin.stl"\nbone = "from-ultrasound"\nbone_radius_mm = 9'
CASE = """
format = 1
[subject]
id = "N1"
limb = "left"
[imaging]
{imaging}
[probe]
length_mm = 20.0
width_mm = 10.0
edge_radius_mm = 2.0
[model]
margin_mm = 12.0
element = "tet4"
[[site]]
name = "p1"
{place}
long_axis = "transverse"
levels = "levels.csv"
[site.noise]
force_n = 0.02
depth_mm = 0.05
source = "spec"
"""
LEVELS = (
    "force_n,depth_mm,swe_mean_m_per_s{more}\n0,0,1.6{first}\n1,1,1.7{rest}\n2,2,1.9{rest}\n4,3,2.1{rest}\n"
)
SIZES = {"size": 3.5, "far_size": 8.0}
RADIUS = 200 / (2 * np.pi)
QUICK = FitOptions(
    gain_deviation=0.02, c_kpa=8.0, c_deviation=0.02, contact_check=False, boundary_check=False,
    max_interval_solves=3,
)  # fmt: skip


def numbers(folder: Path, *, shape: str = SHAPE, place: str = "", more: str = "", first: str = "") -> Case:
    folder.mkdir(exist_ok=True)
    (folder / "case.toml").write_text(CASE.format(imaging=shape, place=place))
    (folder / "levels.csv").write_text(LEVELS.format(more=more, first=first, rest="," if more else ""))
    return Case.open(folder)


def scanned(folder: Path, *, place: str = "position_mm = [0, -31.8, 10]", first: str = ",15") -> Case:
    """A round skin, coarse so as to be quick; the B-mode image shows bone."""
    folder.mkdir(exist_ok=True)
    skin = tube(RADIUS, 160.0).surface(edge=4.0)
    write_surface(folder / "skin.ply", Triangles(skin.points, skin.faces))
    return numbers(folder, shape=SCAN.replace(".stl", ".ply"), place=place, more=",skin_bone_mm", first=first)


def beam_length(folder: Path, point: np.ndarray) -> float:
    """mm from a point to the bone."""
    bone = read_surface(folder / "bone_1.ply")
    nearest = closest_on_triangles(point, bone.points[bone.faces])
    return float(np.linalg.norm(nearest - point, axis=1).min())


@pytest.fixture(scope="module")
def chain(tmp_path_factory) -> tuple[Case, Path]:
    """Numbers only, from segment to run."""
    folder = tmp_path_factory.mktemp("numbers")
    case, out = numbers(folder / "case"), folder / "out"
    segment(case, out=out)
    mesh(case, out=out, options=MeshRequest(**SIZES))
    build_feb(case, out=out)
    run(case, out=out, solver="reference")
    return case, out


@pytest.mark.drawn
def test_numbers_go_the_same_way_as_images(chain):
    case, out = chain
    segmented = read_result(out, "segment")
    skin = read_surface(segmented.path("skin"))
    assert skin.is_closed
    around = np.hypot(skin.points[:, 0], skin.points[:, 1]).max() * 2 * np.pi
    assert around == pytest.approx(200.0, rel=1e-5)  # single precision of the file
    assert beam_length(segmented.folder, np.array([0, -RADIUS, 0])) == pytest.approx(15.0, abs=1e-4)
    assert segmented.data["layers"]["p1"] == {"skin_mm": 1.5, "fat_mm": 4.5}
    assert {"contact_sheet", "site_grid", "bone_1"} <= set(segmented.files)
    assert segmented.path("contact_sheet").with_suffix(".svg").is_file()
    meshed = read_result(out, "mesh", site="p1").data
    assert meshed["checks"]["skin_bone_mm"] == pytest.approx(15.0, abs=0.1)
    assert Chain(case, out).result("run", site="p1").data


def test_every_stage_and_page_says_that_nobody_imaged_it(chain):
    case, out = chain
    for stage, site in (("segment", None), ("mesh", "p1"), ("build-feb", "p1"), ("run", "p1")):
        assert case.imaging.assumed in read_result(out, stage, site=site).warnings, stage
    page = report(case, out=out)
    html = (page.folder / "report.html").read_text()
    assert "Geometry assumed, not imaged: a straight round limb of 200 mm circumference" in html
    assert "What is assumed about the limb" in html
    assert page.data["geometry_assumed"] == case.imaging.assumed


def test_changed_numbers_break_the_chain(chain, tmp_path):
    _, out = chain
    other = numbers(tmp_path / "case", shape=SHAPE.replace("fat_mm = 4.5", "fat_mm = 5.5"))
    with pytest.raises(CaseError, match="imaging changed after `segment` was run"):
        Chain(other, out).result("run", site="p1")


def test_a_diagnosis_takes_the_fits_doubt_or_says_that_there_is_none(chain):
    case, out = chain
    gain, reported = assumed_gain(case, case.sites[0], out)
    assert gain == USUAL_GAIN
    assert "No fit has varied it" in reported


def test_a_joint_fit_says_once_what_is_assumed_and_once_that_its_intervals_do_not_allow_for_it(chain):
    case, out = chain
    options = FitOptions(
        c_kpa=8.0, contact_check=False, boundary_check=False, law="neo-hooke", gain_deviation=0.03,
        max_interval_solves=0,
    )  # fmt: skip
    warnings = fit_joint(case, out=out, options=options).warnings
    assert sum(case.imaging.assumed in each for each in warnings) == 1
    assert warnings.count(NOT_ALLOWED_FOR) == 1


def test_check_tells_it_as_a_warning(tmp_path):
    found = check(numbers(tmp_path / "case").folder)
    assert found.exit_code == 0
    assert any("geometry assumed, not imaged" in each.what for each in found.problems)


@pytest.mark.parametrize(
    ("more", "first"),
    [(",skin_bone_mm", ",19"), (",skin_mm,fat_mm,muscle_mm", ",2,6,11")],
    ids=["bone", "layers"],
)
def test_layers_that_do_not_add_up_are_refused(tmp_path, more, first):
    folder = tmp_path / "case"
    case = numbers(folder)
    rest = "," * more.count(",")
    (folder / "levels.csv").write_text(LEVELS.format(more=more, first=first, rest=rest))
    what = r"do not add up to the thickness: skin 1.5 \+ fat 4.5 \+ muscle 9 = 15 mm, but .* p1 is 19 mm"
    with pytest.raises(CaseError, match=what):
        segment(case, out=tmp_path / "out")
    assert any("do not add up" in each.what for each in check(folder).problems)


@pytest.mark.parametrize(("seen", "is_told"), [(13.5, False), (13.3, True), (12.0, True)])
def test_tissue_that_a_probe_already_pressed_at_level_0_is_a_warning(tmp_path, seen, is_told):
    """The layers add up to 15 mm without the probe; a distance 20 % less, no more, is told."""
    case = numbers(tmp_path / "case", more=",skin_bone_mm", first=f",{seen}")
    limb = assumed_limb(case)
    assert limb.sites["p1"].measured == 15.0
    found = [each for each in limb.warnings if "add up to more than the thickness" in each]
    assert len(found) == is_told
    assert all(f"p1 is {seen:g} mm" in each for each in found)
    with pytest.raises(CaseError, match="do not add up"):
        assumed_limb(numbers(tmp_path / "other", more=",skin_bone_mm", first=",11.9"))


def test_what_was_seen_beside_the_front_is_compared_with_the_round_limb_there(tmp_path):
    """It was compared with the layers in front, and so refused where it was right."""
    middle = RADIUS - 15 - 9  # of the bone, before the limb's own
    right = RADIUS - np.sqrt(9**2 - middle**2)
    aside = {"place": f"position_mm = [{RADIUS}, 0, 0]", "more": ",skin_bone_mm"}
    limb = assumed_limb(numbers(tmp_path / "case", **aside, first=f",{right:.2f}"))
    assert limb.sites["p1"].made == pytest.approx(right)
    what = r"p1 is not anterior, and the round limb is 27.4 mm thick there, but .* is 15 mm"
    with pytest.raises(CaseError, match=what):
        assumed_limb(numbers(tmp_path / "case", **aside, first=",15"))


@pytest.mark.parametrize(("first", "off"), [("", 0.0), (",27", 0.395)], ids=["not seen", "seen"])
def test_beside_the_front_the_bone_is_not_off_by_what_the_round_limb_makes_of_it(tmp_path, first, off):
    """A fit had varied its depth by the 12 mm between the thickness there and in front."""
    place, more = f"position_mm = [{RADIUS}, 0, 0]", ",skin_bone_mm" if first else ""
    site = assumed_limb(numbers(tmp_path / "case", place=place, more=more, first=first)).sites["p1"]
    assert depth_deviation(0.3, site.to_json()) == pytest.approx(np.hypot(0.3, off), abs=0.01)


def test_a_scan_gets_a_bone_as_deep_as_it_was_seen(tmp_path):
    case = scanned(tmp_path / "case")
    result = segment(case, out=tmp_path / "out")
    site = result.data["geometry"]["sites"]["p1"]
    assert (site["skin_bone_mm"], site["source"]) == (15.0, "levels.csv, first row")
    assert site["made_mm"] == pytest.approx(15.0, abs=1e-9)
    assert beam_length(result.folder, np.array(site["skin_point_mm"])) == pytest.approx(15.0, abs=1e-3)
    assert set(result.provenance["made_from"]["files"]) == {"imaging/skin", "site/p1/levels"}
    (tmp_path / "case" / "levels.csv").write_text("force_n,depth_mm\n0,0\n")
    assert Chain(case, tmp_path / "out").broken(result) is not None


def test_a_distance_given_by_hand_wins(tmp_path):
    case = scanned(tmp_path / "case", place="position_mm = [0, -31.8, 10]\nskin_bone_mm = 12")
    site = assumed_limb(case).sites["p1"]
    assert (site.measured, site.source) == (12.0, "skin_bone_mm of the site")


def test_a_site_without_a_distance_is_named(tmp_path):
    case = scanned(tmp_path / "case", first=",")
    with pytest.raises(CaseError, match="site p1 has no distance from skin to bone"):
        segment(case, out=tmp_path / "out")


def test_without_sites_or_probe_ultrasound_saw_nothing(tmp_path):
    case = scanned(tmp_path / "case")
    with pytest.raises(CaseError, match="no site yet with an ultrasound distance to the bone"):
        segment(replace(case, sites=(), raw={}), out=tmp_path / "out")
    with pytest.raises(CaseError, match=r"no \[\[site\]\] .* can be used yet(.|\n)*limbcli check"):
        segment(replace(case, sites=()), out=tmp_path / "out")
    unknown = replace(case.probe, length=float("nan"))
    with pytest.raises(CaseError, match="the probe that the bone's distance refers to is unknown"):
        segment(replace(case, probe=unknown), out=tmp_path / "out")


def test_a_site_off_the_scan_is_refused(tmp_path):
    case = scanned(tmp_path / "case", place="position_mm = [0, -60, 10]")
    with pytest.raises(CaseError, match="from the skin"):
        segment(case, out=tmp_path / "out")


def wide_over(found: dict, name: str) -> float:
    """Width of the interval with the geometry over that without, as ratios of the ends."""
    (low, high), (narrow_low, narrow_high) = (found[k][name] for k in ("interval_95", "interval_95_noise"))
    return (high / low) / (narrow_high / narrow_low)


def test_a_fit_recovers_the_tissue_and_allows_for_the_shape(chain, tmp_path):
    """Simulated on the same numbers: m within its interval, which the varied shapes widen."""
    truth = KnownTissue(c_kpa=8.0, f_kappa=2.0, m=5.0)
    plan = SynthOptions(tissue=truth, same_mesh=True, protocol=LoadingProtocol(step=0.75, max_force=4.0))
    _, meshed = chain
    made, out = tmp_path / "made", tmp_path / "out"
    synth(chain[0], out=meshed, out_case=made, options=plan)
    case = Case.open(made)
    segment(case, out=out)
    mesh(case, out=out, options=MeshRequest(**SIZES))
    build_feb(case, out=out)
    (first,) = fit(case, out=out, solver="reference", options=QUICK)
    found = first.data
    uncertainty = found["geometry_uncertainty"]
    for name, true in (("f_kappa", 2.0), ("m", 5.0)):
        narrow, wide = uncertainty["interval_95_noise"][name], uncertainty["interval_95"][name]
        assert found["interval_95"][name] == wide
        assert wide[0] < true < wide[1]
        assert wide[0] <= narrow[0] < narrow[1] <= wide[1]
    # A flatter limb is stiffer as a whole: f_kappa makes up for it, not m.
    assert wide_over(uncertainty, "f_kappa") > 1.5
    kinds = {each["kind"]: np.array(each["force_change_fraction"]) for each in uncertainty["variations"]}
    assert set(kinds) == {"radius", "depth", "slope", "side", "roundness", "taper"}
    assert (kinds["side"] > 0).all()  # less tissue beside the beam
    (unmade,) = [each for each in first.warnings if "second bone" in each]  # too coarse a mesh for it
    assert "was not evaluated" in unmade
    assert (kinds["depth"] < 0).all()  # more tissue is softer
    assert (kinds["roundness"] > 0).all()  # the last one is the flatter: more of the face at once
    assert uncertainty["n_solves"] == 9
    brief = replace(QUICK, intervals=False)
    again = fit(case, out=out, solver="reference", options=brief)[0].data["geometry_uncertainty"]
    assert again["n_solves"] == 0
    assert again["variations"] == uncertainty["variations"]
    assert assumed_gain(case, case.sites[0], out)[0] == uncertainty["gain_fraction"]
    page = report(case, out=out)
    assert "uncertainty from the assumed geometry" in (page.folder / "report.html").read_text()
    assert json.loads((out / "fit" / "p1" / "geometry.json").read_text())["key"]


def flank_and_slope(folder: Path, *, angle_deg: float, slope: float) -> Case:
    """The scanned limb as it is: its bone slopes along it, and the beam meets the bone's flank."""
    folder.mkdir()
    skin, radius, towards = tube(RADIUS, 160.0), 9.0, np.array([0.0, -1.0, 0.0])
    axis = np.array([0.0, slope, 1.0]) / np.hypot(slope, 1.0)
    seen, side = np.array([0.0, 15.0 - RADIUS, 0.0]), np.cross(axis, towards)
    angle = np.radians(angle_deg)
    centre = seen - radius * (np.cos(angle) * towards - np.sin(angle) * side)
    across = towards - (towards @ axis) * axis
    bone = Rod(centre, axis, radius, -60.0, 60.0, across / np.linalg.norm(across))
    for name, each in (("skin", skin.surface(edge=4.0)), ("bone", bone.surface(edge=3.0))):
        write_surface(folder / f"{name}.ply", Triangles(each.points, each.faces))
    imaging = 'skin = "skin.ply"\nbones = ["bone.ply"]'
    (folder / "case.toml").write_text(
        CASE.format(imaging=imaging, place=f"position_mm = [0, {-RADIUS:.4f}, 0]")
    )
    (folder / "levels.csv").write_text(LEVELS.format(more="", first="", rest=""))
    return Case.open(folder)


def test_a_bone_met_on_its_flank_is_within_the_interval_that_allows_for_it(tmp_path):
    """Simulated on the true surfaces, fitted on a scan and a straight rod: m is off beyond the noise."""
    real = flank_and_slope(tmp_path / "real", angle_deg=30.0, slope=0.15)
    truth = KnownTissue(c_kpa=8.0, f_kappa=2.0, m=5.0)
    plan = SynthOptions(
        tissue=truth, size=3.0, far_size=7.0, noise=0.1,
        protocol=LoadingProtocol(step=0.75, max_force=4.0),
    )  # fmt: skip
    synth(real, out=tmp_path / "real-out", out_case=tmp_path / "made", options=plan)
    case = scanned(tmp_path / "case", place=f"position_mm = [0, {-RADIUS:.4f}, 0]\nskin_bone_mm = 15")
    (case.folder / "levels.csv").write_bytes((tmp_path / "made" / "p1" / "levels.csv").read_bytes())
    quiet = case.file.read_text().replace("0.02", "0.004").replace("0.05", "0.01")
    case.file.write_text(quiet)
    case, out = Case.open(case.folder), tmp_path / "out"
    segment(case, out=out)
    mesh(case, out=out, options=MeshRequest(**SIZES))
    build_feb(case, out=out)
    uncertainty = fit(case, out=out, solver="reference", options=QUICK)[0].data["geometry_uncertainty"]
    (low, _), (alone, _) = uncertainty["interval_95"]["m"], uncertainty["interval_95_noise"]["m"]
    assert low < 5.0 < alone
    moved = {each["kind"]: each["log_shift"]["m"] for each in uncertainty["variations"]}
    assert set(moved) == {"radius", "depth", "slope", "side", "scale"}  # the second bone: too coarse a mesh
    assert moved["side"] > 3 * max(abs(moved["radius"]), abs(moved["depth"]))
