"""The segment stage: same files whatever the case brings."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import nibabel as nib
import numpy as np
import pytest

from limbcli.case import Case, Imaging, ModelOptions, Probe, Site, StatedNoise
from limbcli.errors import CaseError
from limbcli.imaging.segmentation import Segmentation, segment_limb
from limbcli.imaging.surface import read_surface, write_surface
from limbcli.meshing.surfaces import Triangles
from limbcli.phantom.dicom_series import write_series
from limbcli.phantom.mri import acquire, tissue_fractions
from limbcli.phantom.subject import make_subject
from limbcli.progress import Progress
from limbcli.results import read_result
from limbcli.stages.segment import SegmentOptions, edited_labels, segment
from tests.meshing.conftest import tube

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse")]


def case_with(folder, **imaging):
    return Case(
        folder=folder,
        subject="S1",
        limb="left",
        imaging=Imaging(**imaging),
        probe=Probe(name="GE 9L", length=53.0, width=14.0, edge_radius=3.0),
        model=ModelOptions(),
        sites=(),
        raw={},
    )


@pytest.fixture(scope="module")
def series(tmp_path_factory) -> Path:
    """A coarse phantom as a DICOM series."""
    rng = np.random.default_rng(7)
    subject = make_subject(rng, voxel=(2.0, 2.0, 4.0))
    fractions = tissue_fractions(
        subject.anatomy, subject.grid, subject.limb_from_patient, supersampling=(2, 2, 2)
    )
    image = acquire(fractions, subject.grid, rng=rng)
    folder = tmp_path_factory.mktemp("mri")
    write_series(folder, image.signal, subject.grid, subject="Doe^Jane")
    return folder


@pytest.fixture(scope="module")
def bodies(tmp_path_factory) -> SimpleNamespace:
    """Skin and bones as a case may give them: few triangles, far from the scanner's middle."""
    folder = tmp_path_factory.mktemp("bodies")
    made = {
        "skin": tube((0, 0, -500), (0, 0, -320), (38, 46)),
        "bone_tibia": tube((6, -12, -490), (6, -10, -330), (9, 12)),
        "bone_fibula": tube((-16, 6, -485), (-16, 6, -335), (4.5, 5), around=24),
    }
    for name, each in made.items():
        write_surface(folder / f"{name}.ply", each)
    volumes = {name: each.volume / 1e3 for name, each in made.items()}
    return SimpleNamespace(path=lambda name: folder / f"{name}.ply", volume_cm3=volumes)


@pytest.fixture(scope="module")
def found_in_series() -> list[Segmentation]:
    """What was found in the images of `segmented`, for tests that ask no more of them."""
    return []


@pytest.fixture(scope="module")
def segmented(series, found_in_series, tmp_path_factory):
    def kept(*given, **options):
        found_in_series.append(segment_limb(*given, **options))
        return found_in_series[-1]

    out = tmp_path_factory.mktemp("out")
    events = []
    progress = Progress(lambda kind, facts: events.append((kind, facts)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("limbcli.stages.segment.segment_limb", kept)
        result = segment(case_with(series, mri=series), out=out, progress=progress)
    return out, result, events


@pytest.mark.drawn
def test_a_series_leaves_labels_surfaces_markers_and_a_sheet(segmented):
    _, result, _ = segmented
    names = {"labels.nii.gz", "skin.ply", "bone_tibia.ply", "bone_fibula.ply", "contact-sheet.png"}
    assert names <= {path.name for path in result.folder.iterdir()}
    assert [each["number"] for each in result.data["markers"]] == [1, 2]
    assert set(result.provenance["inputs_sha256"]) == {"mri"}
    assert result.path("contact_sheet").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("requested", "side"), [(None, "right"), ("left", "left")])
def test_of_two_limbs_in_view_the_cases_own_is_wanted_unless_another_is_asked_for(
    series, tmp_path, monkeypatch, requested, side
):
    wanted = []

    def failing(volume, *, modality, hints, progress):
        wanted.append(hints.side)
        raise CaseError("enough", where="here", fix="none")

    monkeypatch.setattr("limbcli.stages.segment.segment_limb", failing)
    with pytest.raises(CaseError, match="enough"):
        segment(
            replace(case_with(tmp_path, mri=series), limb="right"),
            out=tmp_path / "out",
            options=SegmentOptions(limb=requested),
        )
    assert wanted == [side]


def test_every_surface_is_closed_and_turned_outward(segmented):
    _, result, _ = segmented
    for name in ("skin", "bone_tibia", "bone_fibula"):
        surface = read_surface(result.path(name))
        assert surface.is_closed, name
        assert surface.volume > 0, name
        assert surface.volume / 1e3 == pytest.approx(result.data["volume_cm3"][name], rel=1e-3)


def test_labels_and_surfaces_agree_in_place(segmented):
    _, result, _ = segmented
    image = nib.load(result.path("labels"))
    skin = read_surface(result.path("skin")).points * [-1, -1, 1]
    index = (skin - image.affine[:3, 3]) @ np.linalg.inv(image.affine[:3, :3]).T
    filled = np.argwhere(np.isin(np.asarray(image.dataobj), (1, 2, 4)))
    np.testing.assert_allclose(index.min(axis=0), filled.min(axis=0) - 0.5, atol=0.8)
    np.testing.assert_allclose(index.max(axis=0), filled.max(axis=0) + 0.5, atol=0.8)


def test_progress_is_told_as_tasks(segmented):
    _, _, events = segmented
    assert {"reading DICOM", "segmenting", "surfaces"} <= {f["name"] for kind, f in events if kind == "task"}


def test_nothing_identifying_is_written(segmented):
    _, result, _ = segmented
    for path in result.folder.iterdir():
        content = re.sub(
            rb"base64,[A-Za-z0-9+/=\s]*", b"", path.read_bytes()
        )  # pixels: any letters, by chance
        assert b"Doe^" not in content, path.name
        assert b"Jane" not in content, path.name
        if path.suffix != ".png":
            assert b"Doe" not in content, path.name


@pytest.fixture(scope="module")
def from_labels(segmented, series, tmp_path_factory):
    """A run on the label map of the run before it, with a site at the first marker."""
    _, first, _ = segmented
    folder = tmp_path_factory.mktemp("from-labels")
    site = Site(
        name="p1",
        position=None,
        marker=1,
        long_axis="transverse",
        levels=folder / "levels.csv",
        trace=None,
        swe_maps=None,
        density_kg_per_m3=1000.0,
        noise=StatedNoise(),
    )
    case = replace(case_with(folder, mri=series, labels=first.path("labels")), sites=(site,))
    return segment(case, out=folder)


def test_a_label_map_replaces_the_automatic_segmentation(segmented, from_labels):
    _, first, _ = segmented
    assert from_labels.data["source"] == "labels"
    assert any("label map" in line for line in from_labels.summary)
    for name, volume in first.data["volume_cm3"].items():
        assert from_labels.data["volume_cm3"][name] == pytest.approx(volume, rel=0.06)
    places = [[each["position_mm"] for each in run.data["markers"]] for run in (first, from_labels)]
    np.testing.assert_allclose(places[0], places[1], atol=1.5)


def test_sites_get_the_thickness_of_their_fat(from_labels):
    """The phantom's fat is 4 to 6 mm, thicker behind; skin 1.6 mm (see limbcli.phantom.anatomy)."""
    assert 4.0 < from_labels.data["layers"]["p1"]["fat_mm"] < 8.0
    assert any("fat" in line for line in from_labels.summary)


def test_surfaces_of_the_case_reach_the_same_files(bodies, tmp_path):
    case = case_with(
        tmp_path,
        skin=bodies.path("skin"),
        bones=(bodies.path("bone_fibula"), bodies.path("bone_tibia")),
    )
    result = segment(case, out=tmp_path)
    assert {"skin", "bone_tibia", "bone_fibula"} <= set(result.files)
    assert read_surface(result.path("bone_tibia")).volume == pytest.approx(
        read_surface(bodies.path("bone_tibia")).volume, rel=1e-4
    )


def test_a_bone_in_another_frame_and_unit_lies_where_it_was_and_it_is_said(bodies, tmp_path):
    """A tibia as 3D Slicer writes it in RAS, and one in metres as 3-matic writes it, beside a skin in LPS."""
    tibia = read_surface(bodies.path("bone_tibia"))
    rows = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in tibia.points * [-1e-3, -1e-3, 1e-3]]
    rows += [f"f {a} {b} {c}" for a, b, c in tibia.faces + 1]
    head = "# 3D Slicer output. SPACE=RAS\n# where 1 unit = 1000.000000 mm\n"
    (tmp_path / "tibia.obj").write_text(head + "\n".join(rows))
    case = case_with(tmp_path, skin=bodies.path("skin"), bones=(tmp_path / "tibia.obj",))
    result = segment(case, out=tmp_path)
    found = read_surface(result.path("bone_tibia"))
    np.testing.assert_allclose(found.points.mean(axis=0), tibia.points.mean(axis=0), atol=0.01)
    assert found.volume == pytest.approx(tibia.volume, rel=1e-3)
    assert any("tibia.obj states the frame RAS: it was turned" in line for line in result.summary)
    assert not any("states no" in line for line in result.warnings)  # our own PLY says where it lies
    skin = bodies.path("skin").read_bytes().replace(b"SPACE=LPS", b"in a room")
    (tmp_path / "skin.ply").write_bytes(skin.replace(b"units mm", b"a limb"))
    result = segment(case_with(tmp_path, skin=tmp_path / "skin.ply", bones=case.imaging.bones), out=tmp_path)
    assert any("in skin.ply no frame is stated" in line for line in result.warnings)


def test_one_file_with_all_bodies_is_taken_apart(bodies, tmp_path):
    parts = [read_surface(bodies.path(name)) for name in ("bone_tibia", "skin", "bone_fibula")]
    starts = np.cumsum([0, *(len(each.points) for each in parts)])
    triangles = [each.faces + start for each, start in zip(parts, starts[:-1], strict=True)]
    whole = Triangles(np.vstack([each.points for each in parts]), np.vstack(triangles))
    write_surface(tmp_path / "limb.ply", whole)
    result = segment(case_with(tmp_path, skin=tmp_path / "limb.ply"), out=tmp_path / "out")
    assert "3 bodies" in result.summary[0]
    found, wanted = result.data["volume_cm3"], bodies.volume_cm3
    assert found["skin"] == pytest.approx(wanted["skin"], rel=1e-3)
    assert found["bone_tibia"] == pytest.approx(wanted["bone_tibia"], rel=1e-3)
    assert found["bone_fibula"] == pytest.approx(wanted["bone_fibula"], rel=1e-3)
    with pytest.raises(CaseError, match=r"only one body[\s\S]*from-ultrasound"):
        segment(case_with(tmp_path, skin=bodies.path("skin")), out=tmp_path / "alone")


@pytest.mark.parametrize("sense", [1, -1])
def test_a_bone_with_a_wall_round_its_marrow_is_whole(bodies, tmp_path, sense):
    tibia = read_surface(bodies.path("bone_tibia"))
    middle = tibia.points.mean(axis=0)
    inner = middle + 0.5 * (tibia.points - middle)
    triangles = np.vstack([tibia.faces, len(tibia.points) + tibia.faces[:, ::sense]])
    write_surface(tmp_path / "tibia.ply", Triangles(np.vstack([tibia.points, inner]), triangles))
    result = segment(
        case_with(tmp_path, skin=bodies.path("skin"), bones=(tmp_path / "tibia.ply",)), out=tmp_path
    )
    assert result.data["volume_cm3"]["bone_tibia"] == pytest.approx(tibia.volume / 1e3, rel=1e-4)
    assert read_surface(result.path("bone_tibia")).volume == pytest.approx(tibia.volume, rel=1e-4)


def test_surfaces_turned_inside_out_are_turned_and_said_so(bodies, tmp_path):
    skin = read_surface(bodies.path("skin"))
    write_surface(tmp_path / "skin.ply", Triangles(skin.points, skin.faces[:, ::-1].copy()))
    case = case_with(tmp_path, skin=tmp_path / "skin.ply", bones=(bodies.path("bone_tibia"),))
    result = segment(case, out=tmp_path)
    assert read_surface(result.path("skin")).volume > 0
    assert any("inward" in line for line in result.warnings)


def test_an_open_skin_has_its_volume_and_its_normals_wherever_it_lies(bodies, tmp_path):
    skin, tibia = (read_surface(bodies.path(name)) for name in ("skin", "bone_tibia"))
    height = skin.points[skin.faces].mean(axis=1)[:, 2]
    opened = skin.faces[height < np.quantile(height, 0.9)]
    volumes = []
    for number, shift in enumerate(np.diag([0.0, 0.0, 900.0])[[0, 2]]):  # they lie at -410 mm
        for name, surface, triangles in (("skin", skin, opened), ("tibia", tibia, tibia.faces)):
            write_surface(tmp_path / f"{name}.ply", Triangles(surface.points + shift, triangles))
        case = case_with(tmp_path, skin=tmp_path / "skin.ply", bones=(tmp_path / "tibia.ply",))
        result = segment(case, out=tmp_path / str(number))
        assert not any("inward" in line for line in result.warnings)
        volumes.append(result.data["volume_cm3"]["skin"])
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-4)
    assert 0.75 < volumes[0] / bodies.volume_cm3["skin"] < 1.0


def test_surfaces_in_metres_are_refused(bodies, tmp_path):
    skin = read_surface(bodies.path("skin"))
    write_surface(tmp_path / "skin.ply", Triangles(skin.points / 1e3, skin.faces))
    with pytest.raises(CaseError, match="mm across"):
        segment(case_with(tmp_path, skin=tmp_path / "skin.ply"), out=tmp_path)


def test_a_failed_run_leaves_the_result_before_it(segmented, tmp_path):
    out, first, _ = segmented
    (tmp_path / "empty").mkdir()
    with pytest.raises(CaseError):
        segment(case_with(tmp_path, mri=tmp_path / "empty"), out=out)
    assert read_result(out, "segment").data == json.loads(json.dumps(first.data))


def edit(path: Path) -> int:
    """Turns the bones of one slice to soft tissue, as a user might in 3D Slicer; returns how many voxels."""
    image = nib.load(path)
    values = np.asarray(image.dataobj).copy()
    k = int(np.argmax((values == 2).sum(axis=(0, 1))))
    changed = int((values[:, :, k] == 2).sum())
    values[:, :, k][values[:, :, k] == 2] = 1
    nib.save(nib.Nifti1Image(values, image.affine), path)
    return changed


def copied(segmented, tmp_path) -> Path:
    out, _, _ = segmented
    shutil.copytree(out / "segment", tmp_path / "segment")
    return tmp_path


def bone_voxels(result) -> int:
    return int((np.asarray(nib.load(result.path("labels")).dataobj) == 2).sum())


def test_an_edited_label_map_wins_until_a_fresh_start(
    segmented, found_in_series, series, tmp_path, monkeypatch
):
    _, first, _ = segmented
    out = copied(segmented, tmp_path)
    case = case_with(tmp_path, mri=series)
    changed = edit(out / "segment" / "labels.nii.gz")
    result = segment(case, out=out)
    assert result.data["source"] == "edited labels"
    assert bone_voxels(result) == bone_voxels(first) - changed
    assert any("edited by hand" in line for line in (*result.summary, *result.warnings))
    assert edited_labels(out) == result.path("labels")  # it wins again when run again
    monkeypatch.setattr("limbcli.stages.segment.segment_limb", lambda *_, **__: found_in_series[0])
    result = segment(case, out=out, fresh=True)
    assert result.data["source"] == "mri"
    assert bone_voxels(result) == bone_voxels(first)


def test_a_label_map_without_bone_is_refused(segmented, tmp_path):
    _, first, _ = segmented
    image = nib.load(first.path("labels"))
    values = np.asarray(image.dataobj).copy()
    values[values == 2] = 1
    nib.save(nib.Nifti1Image(values, image.affine), tmp_path / "labels.nii.gz")
    with pytest.raises(CaseError, match="bone"):
        segment(case_with(tmp_path, labels=tmp_path / "labels.nii.gz"), out=tmp_path)


def test_smoothing_that_takes_much_of_a_thin_bone_is_told(segmented, tmp_path):
    _, first, _ = segmented
    case = case_with(tmp_path, labels=first.path("labels"))
    result = segment(case, out=tmp_path, options=SegmentOptions(smooth=3.0))
    (said,) = (each for each in result.warnings if "smoothing took" in each)
    assert "bone_fibula" in said
    assert not any("smoothing took" in each for each in first.warnings)


def test_an_unknown_seed_is_refused(series, tmp_path):
    with pytest.raises(CaseError, match="seed"):
        segment(
            case_with(tmp_path, mri=series),
            out=tmp_path,
            options=SegmentOptions(seeds=[("fat", (0.0, 0.0, 0.0))]),
        )
