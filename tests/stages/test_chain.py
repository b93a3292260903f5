"""Every input that changes is noticed by every stage that would use what was made from it."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest

from limbcli.case import Case
from limbcli.cli.app import main
from limbcli.errors import CaseError, ToolError
from limbcli.files.atomic import sha256
from limbcli.provenance import staleness
from limbcli.provenance.chain_inputs import noted
from limbcli.provenance.staleness import Chain, note_earlier
from limbcli.results import open_stage, read_result, sealed
from limbcli.stages import build_feb as build_feb_module
from limbcli.stages import diagnose as diagnose_module
from limbcli.stages import fit as fit_module
from limbcli.stages import mesh as mesh_module
from limbcli.stages import run as run_module
from limbcli.stages.batch import BatchOptions, batch
from limbcli.stages.diagnose import diagnose
from limbcli.stages.fit_elements import compare_elements
from limbcli.stages.fit_joint import fit_joint
from limbcli.stages.measuring.images import tissue_between
from limbcli.stages.report import report
from limbcli.stages.report_pages.material import gather
from limbcli.stages.segment import segment
from tests.stages import chain_case

pytestmark = pytest.mark.slow


class Reached(Exception):
    """A stage went on to its work."""


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("chain")
    with pytest.MonkeyPatch.context() as patch:
        chain_case.imaged(patch)
        chain_case.make_results(chain_case.write_case(root / "case"), root / "out")
    return root


@pytest.fixture
def root(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy to change; stages stop where their work would begin."""
    for name in ("case", "out"):
        shutil.copytree(made / name, tmp_path / name)

    def reached(*_: object, **__: object) -> None:
        raise Reached

    for module, name in (
        (mesh_module, "read_limb"), (build_feb_module, "load_model"), (run_module, "read_outline"),
        (fit_module, "read_feb"), (diagnose_module, "places"),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, reached)
    return tmp_path


# ---------------------------------------------------------------- what changes


def in_case(before: str, after: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        path = root / "case" / "case.toml"
        text = path.read_text()
        assert before in text
        path.write_text(text.replace(before, after))

    return change


def in_file(name: str) -> Callable[[Path], None]:
    """One more byte at the end, of a file that was there."""

    def change(root: Path) -> None:
        path = root / name
        path.write_bytes(path.read_bytes() + b"\n")

    return change


def new_slice(root: Path) -> None:
    (root / "case" / "mri" / "IM3").write_bytes(b"IM3")


def gone(name: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        path = root / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return change


def made_again(stage: str, site: str | None, file: str) -> Callable[[Path], None]:
    """The stage's result with another content, whole and from today's inputs."""

    def change(root: Path) -> None:
        folder = root / "out" / stage / (site or "")
        path = folder / f"{stage}.json"
        content = json.loads(path.read_text())
        name = content["files"][file]
        (folder / name).write_bytes((folder / name).read_bytes() + b"\n")
        content["provenance"]["files_sha256"][file] = sha256(folder / name)
        path.write_text(json.dumps(sealed(content)))

    return change


def of_version(version: str | None) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        path = root / "out" / "segment" / "segment.json"
        content = json.loads(path.read_text())
        if version is None:
            del content["provenance"]["made_from"]
        else:
            content["provenance"]["made_from"]["version"] = version
        path.write_text(json.dumps(sealed(content)))

    return change


CHANGES: dict[str, tuple[Callable[[Path], None], str, str]] = {
    # what changed: (how, the stage to run again first, words of the message)
    "a slice of the series": (in_file("case/mri/IM2"), "segment", "imaging.mri changed"),
    "one slice more": (new_slice, "segment", "imaging.mri changed"),
    "place": (in_case("29.5, 0.0]", "29.5, 3.0]"), "segment", "place (position_mm, marker) of site p1"),
    "labels by hand": (in_file("out/segment/labels.nii.gz"), "segment", "labels.nii.gz"),
    "skin by hand": (in_file("out/segment/skin.ply"), "segment", "skin.ply"),
    "a bone is gone": (gone("out/segment/bone_1.ply"), "segment", "is missing"),
    "segment is gone": (gone("out/segment"), "segment", "no result of `segment`"),
    "another subject": (in_case('id = "S1"', 'id = "S2"'), "segment", "is of S1, but the case is of S2"),
    "the other limb": (in_case('"left"', '"right"'), "segment", "subject.limb changed"),
    "an earlier version": (of_version("0.0.1"), "segment", "limbcli 0.0.1"),
    "no version": (of_version(None), "segment", "an earlier limbcli"),
    "probe": (in_case("edge_radius_mm = 2.0", "edge_radius_mm = 3.0"), "mesh", "probe changed"),
    "margin": (in_case("margin_mm = 20.0", "margin_mm = 25.0"), "mesh", "model.margin changed"),
    "element": (in_case('"tet4"', '"tet10"'), "mesh", "model.element changed"),
    "axis": (in_case('"transverse"', '"axial"'), "mesh", "long_axis of site p1"),
    "layer": (in_case('"mri"\n[site.n', '"mri"\nc_kpa = 3.0\n[site.n'), "mesh", "layers of site p1"),
    "new skin": (made_again("segment", None, "skin"), "mesh", "result of `segment` (skin)"),
    "mesh by hand": (in_file("out/mesh/p1/model.npz"), "mesh", "model.npz"),
    "mesh is gone": (gone("out/mesh"), "mesh", "no result of `mesh`"),
    "levels": (in_file("case/levels.csv"), "build-feb", "levels of site p1 changed"),
    "density": (in_case("[site.layers", "density_kg_per_m3 = 1050.0\n[site.layers"), "build-feb", "density"),
    "new mesh": (made_again("mesh", "p1", "model"), "build-feb", "result of `mesh p1` (model)"),
    "model by hand": (in_file("out/build-feb/p1/model.feb"), "build-feb", "model.feb"),
    "model is gone": (gone("out/build-feb/p1/model.feb"), "build-feb", "is missing"),
    "noise": (in_case("force_n = 0.1", "force_n = 0.2"), "", ""),
    "the probe's name": (in_case('name = "small"', 'name = "flat"'), "", ""),
    "picture": (in_file("out/mesh/p1/mesh.png"), "", ""),
}  # fmt: skip
ORDER = ("segment", "mesh", "build-feb", "run")


def calls(case: Case, out: Path) -> dict[str, tuple[str, Callable[[], object]]]:
    """Stages by name: (the last earlier stage that each uses, how it is called)."""
    return {
        "mesh": ("segment", lambda: mesh_module.mesh(case, out=out)),
        "build-feb": ("mesh", lambda: build_feb_module.build_feb(case, out=out)),
        "run": ("build-feb", lambda: run_module.run(case, out=out, solver="reference")),
        "fit": ("build-feb", lambda: fit_module.fit(case, out=out, solver="reference")),
        "fit-joint": ("build-feb", lambda: fit_joint(case, out=out)),
        "fit-elements": ("build-feb", lambda: compare_elements(case, out=out)),
        "diagnose": ("build-feb", lambda: diagnose(case, out=out)),
    }


@pytest.mark.parametrize("change", CHANGES)
def test_every_changed_input_stops_every_stage_that_rests_on_it(root: Path, change: str):
    apply, first, words = CHANGES[change]
    apply(root)
    case, out = Case.open(root / "case"), root / "out"
    for stage, (last, call) in calls(case, out).items():
        if not first or ORDER.index(first) > ORDER.index(last):
            with pytest.raises(Reached):
                call()
            continue
        with pytest.raises(CaseError) as caught:
            call()
        assert words in caught.value.what, stage
        advice, _, rest = caught.value.fix.rpartition(": ")
        assert advice == (
            "give another --out; to replace the results of S1 permanently" if "S1" in words else ""
        )
        reported = [shlex.split(each) for each in rest.split(" && ")]
        assert [each[1] for each in reported] == list(ORDER[ORDER.index(first) : ORDER.index(last) + 1]), (
            stage
        )
        assert {each[2] for each in reported} == {str(case.folder)}
        assert {each[each.index("--out") + 1] for each in reported} == {str(out)}


@pytest.mark.parametrize("change", [name for name, (_, first, _) in CHANGES.items() if first])
def test_the_report_tells_every_change(root: Path, change: str):
    CHANGES[change][0](root)
    page = gather(Case.open(root / "case"), out=root / "out")
    words = CHANGES[change][2]
    reported = [*page.notices, *(each.failure.what for each in page.outcomes.failed if each.failure)]
    assert any(words.lower() in each.lower() for each in reported), reported


def test_a_diagnosis_rests_on_the_thickness_that_the_case_tells(root: Path):
    case, out = Case.open(root / "case"), root / "out"
    with open_stage(out, "diagnose", subject="S1", site="p1") as writer:
        site = noted(case, writer).site("p1")
        note_earlier(out, site, writer)
        assert site.skin_bone is None
    assert Chain(case, out).broken(writer.result) is None
    in_case('trace = "trace.csv"', 'trace = "trace.csv"\nskin_bone_mm = 20.0')(root)
    broken = Chain(Case.open(root / "case"), out).broken(writer.result)
    assert broken is not None
    assert broken.what == "skin_bone_mm of site p1 changed after `diagnose p1` was run"


def test_a_bone_that_somebody_laid_beside_the_results_is_not_one_of_the_limb(root: Path, monkeypatch):
    monkeypatch.undo()
    out = root / "out"
    shutil.copyfile(out / "segment" / "bone_1.ply", out / "segment" / "bone_2.ply")
    segmented = Chain(Case.open(root / "case"), out).result("segment")
    assert len(mesh_module.read_limb(segmented).bones) == 1


def test_a_site_may_move_without_a_new_segmentation_where_its_layers_are_given(root: Path):
    in_case("29.5, 0.0]", "29.5, 3.0]")(root)
    case, out = Case.open(root / "case"), root / "out"
    with pytest.raises(Reached):
        mesh_module.mesh(case, out=out, options=mesh_module.MeshRequest(fat_layer=6.0))
    with pytest.raises(CaseError, match="place"):
        tissue_between(case, case.sites[0], out, None, None)  # type: ignore[arg-type]


def test_a_new_site_is_not_given_the_layers_of_a_segmentation_before_it(root: Path):
    in_case('name = "p1"', 'name = "p9"')(root)
    with pytest.raises(CaseError, match="sites changed after `segment`"):
        mesh_module.mesh(Case.open(root / "case"), out=root / "out")


def test_the_commands_told_mend_the_chain_with_the_options_it_was_made_with(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.undo()
    chain_case.imaged(monkeypatch)
    in_case("29.5, 0.0]", "29.5, 3.0]")(root)
    case, out = Case.open(root / "case"), root / "out"
    with pytest.raises(CaseError) as caught:
        run_module.run(case, out=out)
    assert "--size-mm 4 --far-size-mm 6" in caught.value.fix
    for command in caught.value.fix.split(" && "):
        with pytest.raises(SystemExit) as ended:
            main(shlex.split(command)[1:])
        assert ended.value.code == 0, capsys.readouterr().err
    result = Chain(case, out).result("build-feb", site="p1")
    assert result.provenance["made_from"]["results"]["mesh p1"]["files"]["model"]


def test_the_same_again_leaves_the_chain_whole(root: Path, monkeypatch: pytest.MonkeyPatch):
    """Results are the same byte for byte, so that what was made from them stays good."""
    monkeypatch.undo()
    chain_case.imaged(monkeypatch)
    case, out = Case.open(root / "case"), root / "out"
    before = [read_result(out, stage, site=site) for stage, site in (("segment", None), ("mesh", "p1"))]
    segment(case, out=out)
    mesh_module.mesh(case, out=out, options=mesh_module.MeshRequest(**chain_case.SIZES))
    for old in before:
        new = read_result(out, old.stage, site=old.site)
        assert new.provenance["files_sha256"] == old.provenance["files_sha256"]
    Chain(case, out).result("build-feb", site="p1")


def test_a_label_map_edited_by_hand_stays_with_its_subject_and_its_series(
    root: Path, monkeypatch: pytest.MonkeyPatch
):
    chain_case.imaged(monkeypatch)
    labels = root / "out" / "segment" / "labels.nii.gz"
    edited = labels.read_bytes() + b"edited"
    labels.write_bytes(edited)
    in_file("case/mri/IM1")(root)
    with pytest.raises(CaseError, match="on another series"):
        segment(Case.open(root / "case"), out=root / "out")
    in_case('id = "S1"', 'id = "S2"')(root)
    with pytest.raises(CaseError, match="is of S1"):
        segment(Case.open(root / "case"), out=root / "out")
    assert labels.read_bytes() == edited


def with_label(path: Path, before: int, after: int) -> None:
    """One voxel of a label map set from one label to another, as by hand."""
    image = nib.load(path)
    values = np.asarray(image.dataobj).copy()
    values[tuple(np.argwhere(values == before)[0])] = after
    nib.save(nib.Nifti1Image(values, image.affine), path)


def test_an_edited_label_map_outlives_a_batch_that_refuses_it(root: Path, monkeypatch: pytest.MonkeyPatch):
    chain_case.imaged(monkeypatch)
    labels = root / "out" / "segment" / "labels.nii.gz"
    with_label(labels, 4, 7)
    for _ in range(2):
        refused = batch(root / "case", out=root / "out")
        assert [each.stage for each in refused.failures] == ["segment"]
    with_label(labels, 7, 1)
    assert segment(Case.open(root / "case"), out=root / "out").data["source"] == "edited labels"


def test_a_label_map_without_a_result_beside_it_is_not_overwritten(
    root: Path, monkeypatch: pytest.MonkeyPatch
):
    chain_case.imaged(monkeypatch)
    case, out = Case.open(root / "case"), root / "out"
    labels = out / "segment" / "labels.nii.gz"
    (out / "segment" / "segment.json").unlink()
    before = labels.read_bytes()
    with pytest.raises(CaseError, match="may have been edited by hand"):
        segment(case, out=out)
    assert [each.stage for each in batch(root / "case", out=out).failures] == ["segment"]
    assert labels.read_bytes() == before
    assert segment(case, out=out, fresh=True).data["source"] == "mri"


def test_what_the_report_tells_is_among_its_warnings_with_the_commands(root: Path):
    in_file("case/levels.csv")(root)
    found = report(Case.open(root / "case"), out=root / "out")
    (reported,) = [each for each in found.warnings if "evels of site p1 changed" in each]
    assert f"limbcli build-feb {root / 'case'} --site p1 --out {root / 'out'}" in reported


def test_another_subjects_results_are_not_on_the_page(root: Path):
    in_case('id = "S1"', 'id = "S2"')(root)
    found = report(Case.open(root / "case"), out=root / "out")
    assert found.data["stages"]["segment"] == "failed"
    assert "done" not in found.data["stages"].values()


def test_a_batch_mends_what_no_key_sees(root: Path, monkeypatch: pytest.MonkeyPatch):
    """The fat under a site that moved is told anew, and a result that was touched is made again."""
    monkeypatch.undo()
    chain_case.imaged(monkeypatch)
    case, out = root / "case", root / "out"

    def none(*_: object) -> None:
        raise ToolError("no solver today", where="test", fix="none")

    monkeypatch.setattr(run_module, "choose", none)
    options = BatchOptions(solver="reference")
    batch(case, out=out, options=options)
    again = batch(case, out=out, options=options)
    assert {"segment", "mesh p1", "build-feb p1"} <= set(again.fresh)
    in_case("29.5, 0.0]", "29.5, 3.0]")(root)
    moved = batch(case, out=out, options=options)
    assert {"segment", "mesh p1", "build-feb p1"} <= set(moved.ran)
    assert [each.stage for each in moved.failures] == ["run"]
    in_file("out/mesh/p1/model.npz")(root)
    assert {"mesh p1"} <= set(batch(case, out=out, options=options).ran)


@pytest.mark.parametrize(
    "damaged", [None, [], {}, {"case": []}, {"case": {}, "files": {}, "results": {"segment": None}}]
)
def test_a_damaged_account_of_what_a_result_was_made_from_is_none(root: Path, damaged: object):
    path = root / "out" / "segment" / "segment.json"
    content = json.loads(path.read_text())
    content["provenance"]["made_from"] = damaged
    path.write_text(json.dumps(sealed(content)))
    with pytest.raises(CaseError, match="an earlier limbcli"):
        mesh_module.mesh(Case.open(root / "case"), out=root / "out")
    path.write_text(json.dumps({**content, "provenance": []}))
    with pytest.raises(CaseError, match="cannot be read"):
        mesh_module.mesh(Case.open(root / "case"), out=root / "out")


def test_hashes_are_remembered_only_of_files_that_have_settled(tmp_path: Path):
    path = tmp_path / "image"
    path.write_bytes(b"a")
    first = sha256(path)
    os.utime(path, (1e9, 1e9))
    path.write_bytes(b"b")
    os.utime(path, (1e9, 1e9))
    assert sha256(path) != first


def test_a_remembered_hash_is_not_kept_for_a_file_with_the_same_time_and_size(tmp_path, monkeypatch):
    """Stamps of modification can be set by hand (as copying does); those of the inode cannot."""
    path = tmp_path / "image"
    path.write_bytes(b"a")
    monkeypatch.setattr(time, "time", lambda: path.stat().st_ctime + 60)
    first = sha256(path)
    stamp = path.stat()
    monkeypatch.undo()
    time.sleep(0.02)
    path.write_bytes(b"b")
    os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert sha256(path) != first


def test_a_result_without_links_of_its_own_is_taken_as_it_is(tmp_path: Path):
    case = chain_case.write_case(tmp_path / "case")
    with open_stage(tmp_path / "out", "mesh", subject="S1", site="p1"):
        pass
    assert staleness.Chain(case, tmp_path / "out").result("mesh", site="p1").stage == "mesh"
