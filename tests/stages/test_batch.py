"""batch: one failure never hides another's result, and stale results never count."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from limbcli.case import Case
from limbcli.errors import CaseError, MeshError
from limbcli.provenance.chain_inputs import noted
from limbcli.provenance.requested_options import requested_by_options
from limbcli.results import StageWriter, open_stage, read_result
from limbcli.stages import batch as module
from limbcli.stages import diagnose, fit_elements, fit_joint
from limbcli.stages.batch import BatchOptions, batch
from limbcli.stages.batch_cases import n_processes
from limbcli.stages.build_feb import TissueOptions
from limbcli.stages.fit import FitOptions
from limbcli.stages.limb import LimbOptions
from limbcli.stages.mesh import MeshRequest
from limbcli.stages.run import RunOptions
from limbcli.stages.segment import SegmentOptions
from limbcli.stages.socket import SocketOptions
from tests.case.test_case_text import two_sites

STAGES = ("mesh", "build-feb", "run", "fit")
BEFORE = {"mesh": "", "build-feb": "mesh"}
OPTIONS = {
    each.__name__: each
    for each in (
        SegmentOptions, MeshRequest, FitOptions, TissueOptions, RunOptions, LimbOptions, SocketOptions,
    )
}  # fmt: skip
CALLED: dict[str, list[dict]] = {}


def _options_of(options, given: dict) -> dict:
    """What a stage was called with beyond its defaults."""
    own = requested_by_options(options) if options is not None else {}
    return {**own, **{k: v for k, v in given.items() if k not in ("progress", "solver", "febio") and v}}


def ask(case: Case, writer: StageWriter, out: Path, sites: Sequence[str] = ()) -> None:
    """What a stage of this name asks of its case and of the stage before it."""
    own, stage = noted(case, writer), writer.stage
    if stage == "segment":
        assert own.imaging.mri
    for each in map(own.site, filter(None, [writer.site, *sites])):
        if stage == "mesh":
            asked = [own.probe, each.position, each.long_axis, each.layers]
            assert asked + ([] if each.fibres.given else [own.imaging.fibres])
        else:
            assert each.levels
        if stage.startswith("fit"):
            assert each.noise
        before = "fit" if stage == "diagnose" else BEFORE.get(stage, "build-feb")
        if before and (out / before / each.name / f"{before}.json").is_file():
            writer.used_result(read_result(out, before, site=each.name), files=["text"])


def by_hand(case: Path, out: Path, stage: str, site: str | None = "p1", **requested) -> None:
    """A stage's result as its own command leaves it."""
    with open_stage(out, stage, subject="S1", site=site) as writer:
        writer.file("text", "a.txt").write_text(f"by hand {requested}")
        writer.data["asked"] = requested
        ask(Case.open(case), writer, out)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Every stage replaced by one that leaves a result, unless the case has a file `fail-STAGE`."""
    made: list[str] = []
    reported = CALLED
    reported.clear()

    def fake(stage: str):
        def work(case: Case, *, out: Path, sites=(None,), options=None, **given):
            for site in sites:
                own = _options_of(options, given)
                reported.setdefault(f"{stage} {site}" if site else stage, []).append(own)
                made.append(f"{stage} {site}" if site else stage)
                if (stage, site) == ("mesh", "p2") and (case.folder / "break").exists():
                    raise MeshError("no skin under the probe", where="site p2", fix="move it")
                if (case.folder / f"fail-{stage}").exists():
                    raise MeshError("it does not fit", where=stage, fix="mend it")
                with open_stage(out, stage, subject=case.subject, site=site) as writer:
                    name = {"report": "report.html", "build-feb": "model.feb"}.get(stage, "a.txt")
                    writer.file("text", name).write_text((case.folder / "p1.csv").read_text())
                    ask(case, writer, out)

        return work

    def edited(out: Path) -> Path | None:
        path = out / "edited.nii.gz"
        return path if path.exists() else None

    for stage in ("segment", *STAGES, "limb", "socket", "report"):
        name = stage.replace("-", "_")
        own = {name: staticmethod(fake(stage)), "edited_labels": staticmethod(edited)}
        holder = type("holder", (), {**OPTIONS, **own})
        monkeypatch.setitem(__import__("sys").modules, f"limbcli.stages.{name}", holder)
    monkeypatch.setattr(module, "code_hash", lambda: "code")
    return made


def test_all_stages_run_once_and_then_nothing(tmp_path: Path, calls: list[str]):
    case = two_sites(tmp_path / "case")
    outcome = batch(case, out=tmp_path / "out")
    assert calls == ["segment", *[f"{s} {p}" for p in ("p1", "p2") for s in STAGES], "report"]
    assert outcome.report is not None
    assert outcome.report.is_file()
    calls.clear()
    assert batch(case, out=tmp_path / "out").ran == []
    assert calls == []


def test_changed_measurement_redoes_only_what_follows(tmp_path: Path, calls: list[str]):
    case = two_sites(tmp_path / "case")
    batch(case, out=tmp_path / "out")
    calls.clear()
    (case / "p2.csv").write_text("force_n,depth_mm\n0,0\n2,1\n5,2\n")
    batch(case, out=tmp_path / "out")
    assert calls == ["build-feb p2", "run p2", "fit p2", "report"]


def with_socket(folder: Path) -> Path:
    case = two_sites(folder)
    with (case / "case.toml").open("a") as stream:
        stream.write("[socket]\nlimb_nodes = 5000\n")
    return case


def test_a_report_follows_a_socket_that_fails_no_more(tmp_path: Path, calls: list[str]):
    case, out = with_socket(tmp_path / "case"), tmp_path / "out"
    (case / "fail-socket").touch()
    assert [each.stage for each in batch(case, out=out).failures] == ["socket"]
    assert (CALLED["limb"], CALLED["socket"]) == ([{"nodes": 5000}], [{"intervals": False}])
    calls.clear()
    (case / "fail-socket").unlink()
    assert batch(case, out=out).failures == []
    assert calls == ["socket", "report"]


def test_the_limb_is_made_with_the_templates_of_the_batch(tmp_path: Path, calls: list[str]):
    case, out, own = with_socket(tmp_path / "case"), tmp_path / "out", tmp_path / "own"
    (own / "feb").mkdir(parents=True)
    (own / "feb" / "contact.j2").write_text("first")
    options = BatchOptions(templates=own)
    batch(case, out=out, options=options)
    assert CALLED["limb"] == [{"nodes": 5000, "templates": own}]
    (own / "feb" / "contact.j2").write_text("second")
    calls.clear()
    batch(case, out=out, options=options)
    assert [each for each in calls if each in ("limb", "socket")] == ["limb", "socket"]


def test_without_surfaces_there_is_no_limb_for_a_socket(tmp_path: Path, calls: list[str]):
    case, out = with_socket(tmp_path / "case"), tmp_path / "out"
    (case / "fail-segment").touch()
    assert [each.stage for each in batch(case, out=out).failures] == ["segment"]
    assert calls == ["segment", "report"]
    for stage in ("limb", "socket"):
        assert "because `segment` failed" in (out / stage / "error.json").read_text()


def test_what_a_mesh_is_not_made_from_redoes_none(tmp_path: Path, calls: list[str]):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    batch(case, out=out)
    text = (case / "case.toml").read_text()
    calls.clear()
    (case / "case.toml").write_text(text.replace("GE 9L", "GE 9L-D"))
    batch(case, out=out)
    assert calls == ["report"]
    for more, first in (("[site.noise]\nforce_n = 0.2\n", "fit"), ("marker = 1\n", "mesh")):
        calls.clear()
        changed = text.rpartition("position_mm")[0] + 'long_axis = "axial"\nlevels = "p2.csv"\n'
        (case / "case.toml").write_text(changed + more if first == "mesh" else text + more)
        batch(case, out=out)
        assert calls[0] == f"{first} p2"
        assert not any(each.endswith("p1") for each in calls)


def test_changed_fibres_redo_the_meshes_that_use_them(tmp_path: Path, calls: list[str]):
    """A map of the whole limb; site p2 tells its own direction, and does not look at it."""
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    toml = case / "case.toml"
    text = toml.read_text().replace('mri = "mri"', 'mri = "mri"\nfibres = "v1.nii.gz"')
    toml.write_text(text + "fibre_direction = [0.0, 0.0, 1.0]\n")
    (case / "v1.nii.gz").write_text("one")
    batch(case, out=out)
    calls.clear()
    (case / "v1.nii.gz").write_text("two")
    batch(case, out=out)
    assert [each for each in calls if each.startswith("mesh")] == ["mesh p1"]
    assert "segment" not in calls


def test_force_and_another_element_redo(tmp_path: Path, calls: list[str]):
    case = two_sites(tmp_path / "case")
    batch(case, out=tmp_path / "out")
    calls.clear()
    batch(case, out=tmp_path / "out", options=BatchOptions(element="tet4"))
    assert calls[0] == "mesh p1"
    calls.clear()
    batch(case, out=tmp_path / "out", options=BatchOptions(element="tet4", force=True))
    assert calls[0] == "segment"


def test_a_febio_that_comes_goes_or_is_another_redoes_what_is_simulated(
    tmp_path: Path, calls: list[str], monkeypatch: pytest.MonkeyPatch
):
    case, out, binary = two_sites(tmp_path / "case"), tmp_path / "out", tmp_path / "bin" / "febio4"
    binary.parent.mkdir()
    monkeypatch.setenv("PATH", f"{binary.parent}:/usr/bin:/bin")
    monkeypatch.delenv("LIMBCLI_FEBIO", raising=False)
    simulated = ["run p1", "fit p1", "run p2", "fit p2", "report"]

    def again(solver: str = "auto") -> list[str]:
        calls.clear()
        batch(case, out=out, options=BatchOptions(solver=solver))
        return list(calls)

    def install(content: str) -> None:
        binary.write_text(content)
        binary.chmod(0o755)

    again()
    assert again("reference") == []  # the very solver that was taken where there is no FEBio
    install('#!/bin/sh\ncat "$0".version # \n')
    (tmp_path / "bin" / "febio4.version").write_text("  version 4.5.0\n")
    assert again() == simulated
    assert again() == []
    assert again("febio") == []
    install('#!/bin/sh\ncat "$0".version # another build\n')
    assert again() == simulated
    (tmp_path / "bin" / "febio4.version").write_text("  version 4.11.0\n")  # its libraries, say
    install('#!/bin/sh\ncat "$0".version # another build\n')
    assert again() == simulated
    binary.unlink()
    assert again() == simulated


def test_one_site_failing_leaves_the_other_and_a_report(tmp_path: Path, calls: list[str]):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    batch(case, out=out)
    (case / "break").touch()
    calls.clear()
    outcome = batch(case, out=out, options=BatchOptions(force=True))
    assert [(each.stage, each.site) for each in outcome.failures] == [("mesh", "p2")]
    assert "fit p1" in calls
    assert "fit p2" not in calls
    assert calls[-1] == "report"
    error = json.loads((out / "mesh" / "p2" / "error.json").read_text())
    assert (error["error"], error["fix"]) == ("MeshError", "move it")
    stale = json.loads((out / "fit" / "p2" / "error.json").read_text())
    assert "not run" in stale["what"]
    assert not (out / "fit" / "p2" / "fit.json").exists()


def test_a_place_that_cannot_be_told_leaves_the_other_sites_their_fits_and_diagnoses(
    tmp_path: Path, calls: list[str], monkeypatch: pytest.MonkeyPatch
):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    toml = case / "case.toml"
    head, _, last = toml.read_text().rpartition("position_mm")
    toml.write_text(f"{head}marker = 9\n{last.partition(chr(10))[2]}")
    (case / "break").touch()

    def diagnosed(of: Case, *, sites: list[str], **_) -> None:
        calls.append(f"diagnose {sites}")
        by_hand(of.folder, out, "diagnose", sites[0])

    monkeypatch.setattr(diagnose, "diagnose", diagnosed)
    outcome = batch(case, out=out, options=BatchOptions(diagnose=True))
    assert [(each.stage, each.site) for each in outcome.failures] == [("mesh", "p2")]
    assert "fit p1" in calls
    assert "diagnose ['p1']" in calls
    assert outcome.report is not None


@pytest.mark.parametrize("gone", ["segment", "mesh", "fit", "report", "mesh/p1/mesh.json", "fit/p1/a.txt"])
def test_results_that_were_removed_are_made_again(tmp_path: Path, calls: list[str], gone: str):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    batch(case, out=out)
    path, stage = out / gone, gone.partition("/")[0]
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    outcome = batch(case, out=out)
    assert not outcome.failures
    assert any(each.startswith(stage) for each in outcome.ran)


def test_failure_is_tried_again_next_time(tmp_path: Path, calls: list[str]):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    (case / "break").touch()
    batch(case, out=out)
    (case / "break").unlink()
    calls.clear()
    outcome = batch(case, out=out)
    assert calls == [*[f"{s} p2" for s in STAGES], "report"]
    assert not outcome.failures
    assert not (out / "mesh" / "p2" / "error.json").exists()


def test_a_number_of_processes_beside_a_scheduler_is_refused():
    with pytest.raises(CaseError, match="--jobs 2 and --scheduler are given"):
        n_processes(2, "tcp://10.0.0.5:8786", 3)
    assert n_processes(None, "tcp://10.0.0.5:8786", 3) == 1


def test_case_that_cannot_be_read_gets_a_page_and_a_mistyped_one_an_error(tmp_path: Path):
    case = two_sites(tmp_path / "case")
    (case / "p1.csv").unlink()
    outcome = batch(case, out=tmp_path / "out")
    assert [(each.stage, each.error.exit_code) for each in outcome.failures] == [("check", 2)]
    assert outcome.report is not None
    assert "p1.csv" in outcome.report.read_text(encoding="utf-8")
    with pytest.raises(CaseError, match="there is no case folder"):
        batch(tmp_path / "nowhere", out=tmp_path / "out")


def test_labels_edited_by_hand_redo_everything_that_follows(tmp_path: Path, calls: list[str]):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    batch(case, out=out)
    calls.clear()
    (out / "edited.nii.gz").write_text("by hand")
    batch(case, out=out)
    assert calls[:2] == ["segment", "mesh p1"]
    calls.clear()
    batch(case, out=out)
    assert calls == []


JOINT = {"law": "holmes-mow", "laws": [{}], "sites": ["p1", "p2"], "asked": {"c_kpa": 7.0}}


@pytest.fixture
def on_demand(tmp_path: Path, calls: list[str], monkeypatch: pytest.MonkeyPatch):
    """A case after a batch, with a joint fit of both sites and elements compared at p2, made by hand."""
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    batch(case, out=out)
    requested: list[dict] = []

    def leave(stage: str, site: str | None, data: dict, sites: tuple[str, ...]) -> None:
        with open_stage(out, stage, subject="S1", site=site) as writer:
            ask(Case.open(case), writer, out, sites)
            writer.data.update(data)

    def joint(case: Case, *, out: Path, sites, options, **_) -> None:
        calls.append("fit-joint")
        requested.append({"law": options.law, "compare": options.compare_laws, "c_kpa": options.c_kpa})
        leave("fit-joint", None, JOINT, tuple(sites))

    def elements(case: Case, *, out: Path, sites, options, **_) -> None:
        calls.append(f"fit-elements {sites[0]}")
        leave("fit-elements", sites[0], {}, (sites[0],))

    monkeypatch.setattr(fit_joint, "fit_joint", joint)
    monkeypatch.setattr(fit_elements, "compare_elements", elements)
    leave("fit-joint", None, JOINT, ("p1", "p2"))
    leave("fit-elements", "p2", {}, ("p2",))
    calls.clear()
    return case, out, requested


def test_fits_made_on_demand_are_taken_over_and_shown(on_demand, calls: list[str]):
    case, out, _ = on_demand
    outcome = batch(case, out=out)
    assert calls == ["report"], "there is more to show"
    assert {"fit-joint", "fit-elements p2"} <= set(outcome.fresh)
    calls.clear()
    assert batch(case, out=out).ran == []


def test_fits_made_on_demand_are_made_again_as_they_were_where_something_changed(on_demand, calls: list[str]):
    case, out, requested = on_demand
    batch(case, out=out)
    calls.clear()
    (case / "p1.csv").write_text("force_n,depth_mm\n0,0\n2,1\n5,2\n")
    batch(case, out=out)
    assert calls == ["build-feb p1", "run p1", "fit p1", "fit-joint", "report"]
    assert requested == [{"law": "holmes-mow", "compare": True, "c_kpa": 7.0}]
    calls.clear()
    assert batch(case, out=out).ran == []


def test_a_fit_on_demand_behind_a_failure_waits_and_comes_back(on_demand, calls: list[str]):
    case, out, _ = on_demand
    (case / "break").touch()
    batch(case, out=out, options=BatchOptions(force=True))
    assert "fit-joint" not in calls
    assert "not run" in json.loads((out / "fit-joint" / "error.json").read_text())["what"]
    (case / "break").unlink()
    calls.clear()
    outcome = batch(case, out=out)
    assert not outcome.failures
    assert {"fit-joint", "fit-elements p2"} <= set(calls)
    assert not (out / "fit-joint" / "error.json").exists()


# ---------------------------------------------------------------- options by hand


def test_a_fit_made_by_hand_stays_until_something_changes_and_is_then_made_the_same_way(
    tmp_path: Path, calls: list[str]
):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    batch(case, out=out)
    by_hand(case, out, "fit", stiffness_map=True, gain_deviation=0.1)
    calls.clear()
    outcome = batch(case, out=out)
    assert calls == ["report"]
    assert read_result(out, "fit", site="p1").data["asked"]["stiffness_map"]
    assert outcome.kept == {"fit p1": "--stiffness-map --gain-deviation-fraction 0.1"}
    calls.clear()
    (case / "p1.csv").write_text("force_n,depth_mm\n0,0\n2,1\n5,2\n")
    batch(case, out=out)
    assert calls == ["build-feb p1", "run p1", "fit p1", "report"]
    assert CALLED["fit p1"][-1] == {"stiffness_map": True, "gain_deviation": 0.1}
    calls.clear()
    assert batch(case, out=out).kept
    assert calls == []


def test_options_by_hand_outlive_a_failure_and_end_with_a_plain_call_or_on_demand(
    tmp_path: Path, calls: list[str]
):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    by_hand(case, out, "mesh", "p2", fat_layer=6.0, element="tet4")
    (case / "break").touch()
    batch(case, out=out)
    (case / "break").unlink()
    batch(case, out=out)
    assert CALLED["mesh p2"] == [{"fat_layer": 6.0, "element": "tet4"}] * 2
    batch(case, out=out, options=BatchOptions(element="tet10"))
    assert CALLED["mesh p2"][-1] == {"fat_layer": 6.0, "element": "tet10"}, "the batch's own option wins"
    batch(case, out=out)
    assert CALLED["mesh p2"][-1]["element"] == "tet4"
    batch(case, out=out, options=BatchOptions(defaults=True))
    assert CALLED["mesh p2"][-1] == {}
    by_hand(case, out, "segment", None, seeds=[["bone", [1.0, 2.0, 3.0]]], smooth=0.5)
    assert batch(case, out=out).kept == {"segment": "--seed bone=1,2,3 --smooth 0.5"}
    by_hand(case, out, "segment", None)
    assert batch(case, out=out).kept == {}
    assert CALLED["segment"][-1] == {}


def test_the_page_is_made_with_the_templates_of_the_batch_or_of_its_last_call_by_hand(
    tmp_path: Path, calls: list[str]
):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    own, another = tmp_path / "own", tmp_path / "another"
    for each in (own, another):
        (each / "report").mkdir(parents=True)
        (each / "report" / "style.css").write_text("body {}")
    batch(case, out=out)
    calls.clear()
    batch(case, out=out, options=BatchOptions(templates=own))
    assert calls == ["report"], "templates of pages say nothing to a model"
    assert CALLED["report"][-1] == {"templates": own}
    by_hand(case, out, "report", None, templates=str(another))
    assert batch(case, out=out).kept == {"report": f"--templates {another}"}
    assert CALLED["report"][-1] == {"templates": another}
    (another / "report" / "style.css").write_text("p {}")
    text = (case / "case.toml").read_text()
    (case / "case.toml").write_text("format = 2")
    assert [each.stage for each in batch(case, out=out).failures] == ["check"]
    (case / "case.toml").write_text(text)
    calls.clear()
    batch(case, out=out)
    assert calls == ["report"]
    assert CALLED["report"][-1] == {"templates": another}


def test_a_diagnosis_is_made_again_as_it_was_asked_for_by_hand(
    tmp_path: Path, calls: list[str], monkeypatch: pytest.MonkeyPatch
):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    given = diagnose.DiagnoseOptions(effects=("tilt",), measured={"tare_n": 0.4}, solver="febio").requested()
    reported: list[dict] = []

    def diagnosed(of: Case, *, sites: list[str], options: diagnose.DiagnoseOptions, **_) -> None:
        reported.append(options.requested())
        for site in sites:
            by_hand(of.folder, out, "diagnose", site, **options.requested())

    monkeypatch.setattr(diagnose, "places", lambda *_, **__: [[site] for site in Case.open(case).sites])
    monkeypatch.setattr(diagnose, "diagnose", diagnosed)
    batch(case, out=out)
    for site in ("p1", "p2"):
        by_hand(case, out, "diagnose", site, **given)
    kept = batch(case, out=out, options=BatchOptions(diagnose=True)).kept
    assert kept["diagnose p1"] == "--effects tilt --measured tare_n=0.4"
    assert reported == [], "what was made by hand stays"
    (case / "p2.csv").write_text("force_n,depth_mm\n0,0\n2,1\n5,2\n")
    batch(case, out=out, options=BatchOptions(diagnose=True))
    assert reported == [given]
    batch(case, out=out, options=BatchOptions(diagnose=True, defaults=True))
    assert reported[1:] == [{}, {}]


def test_options_by_hand_outlive_a_failure_of_what_all_sites_share(
    tmp_path: Path, calls: list[str], monkeypatch: pytest.MonkeyPatch
):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    by_hand(case, out, "mesh", "p2", fat_layer=6.0)

    def fails(*_: object, **__: object) -> None:
        raise CaseError("no limb can be separated", where="MRI series", fix="check it")

    with monkeypatch.context() as patch:
        patch.setattr(sys.modules["limbcli.stages.segment"], "segment", fails)
        assert [each.stage for each in batch(case, out=out).failures] == ["segment"]
    batch(case, out=out)
    assert CALLED["mesh p2"] == [{"fat_layer": 6.0}]


def test_a_fit_by_hand_of_another_model_or_from_before_a_mesh_study_is_made_again(
    tmp_path: Path, calls: list[str]
):
    case, out = two_sites(tmp_path / "case"), tmp_path / "out"
    batch(case, out=out)
    by_hand(case, out, "build-feb", f_kappa=50.0)
    by_hand(case, out, "fit")
    calls.clear()
    batch(case, out=out)
    assert "fit p1" in calls
    with open_stage(out, "mesh-study", subject="S1", site="p1") as writer:
        writer.data["numerical_error_fraction"] = 0.2
    calls.clear()
    batch(case, out=out)
    assert calls == ["fit p1", "report"]
