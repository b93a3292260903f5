"""What a stage asks of its case is recorded, and a change is noticed exactly where it was asked."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from limbcli.case import Case
from limbcli.case.noting import noting, unnoted, with_values
from limbcli.diagnosis.prepare import Preparation
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, read_result, sealed
from limbcli.stages import diagnose as diagnose_module
from limbcli.stages.build_feb import build_feb
from limbcli.stages.diagnose import DiagnoseOptions, diagnose
from limbcli.stages.fit import FitOptions, fit
from limbcli.stages.limb import LimbOptions, limb
from limbcli.stages.mesh import MeshRequest, mesh
from limbcli.stages.report import report
from limbcli.stages.run import run
from limbcli.stages.segment import segment
from tests.meshing.stump import quickly_meshed
from tests.stages import chain_case, changed_keys

pytestmark = pytest.mark.slow

_QUICK = FitOptions(intervals=False, contact_check=False, boundary_check=False)
STAGES: dict[str, Any] = {
    "segment": (segment, {}),
    "mesh": (mesh, {"options": MeshRequest(size=7.0, far_size=12.0)}),
    "build-feb": (build_feb, {}),
    "run": (run, {"solver": "reference"}),
    "fit": (fit, {"solver": "reference", "options": _QUICK}),
    "limb": (limb, {"options": LimbOptions(element="tet4", nodes=3_000, distal_cut=True)}),
    "diagnose": (diagnose, {"options": DiagnoseOptions(effects=("tilt",), interventions=False)}),
    "report": (report, {}),
}
OF_CASE = ("segment", "limb", "report")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of case and results."""
    root = tmp_path_factory.mktemp("keys")
    case = chain_case.write_case(root / "case")
    with pytest.MonkeyPatch.context() as patch:
        chain_case.imaged(patch)
        prepared_only(patch)
        quickly_meshed(patch)
        for stage, (work, options) in STAGES.items():
            work(case, out=root / "out", **options)
            if stage == "limb":
                shutil.copytree(root / "out", root / "limb-out")
    return root


def out_of(root: Path, stage: str) -> Path:
    """The results as they were when the stage was made: a later diagnosis makes a limb out of date."""
    return root / ("limb-out" if stage == "limb" else "out")


def prepared_only(patch: pytest.MonkeyPatch) -> None:
    """A diagnosis that reads its inputs and makes its working mesh, without the search for effects."""

    def prepare(case: Case, site: Any, *_: Any, out: Path, mesh: Any, progress: Any, **__: Any) -> Any:
        read = Preparation(case, site, out, mesh, progress)
        read._working_mesh()
        curves = SimpleNamespace(changes=SimpleNamespace(not_simulated={}), site=None)
        return SimpleNamespace(
            site=site, notes=read.notes, interventions=[], curves=curves,
            simulations=SimpleNamespace(in_part={}, n_solves=0, close=lambda: None),
        )  # fmt: skip

    model = SimpleNamespace(not_simulated=set(), settle_noise=lambda: None)
    patch.setattr(diagnose_module, "prepare", prepare)
    patch.setattr(diagnose_module, "SiteForwardModel", lambda *_: model)
    patch.setattr(diagnose_module, "_content", lambda *_: {"sentences": [], "sites": ["p1"]})
    patch.setattr(diagnose_module.verdict, "diagnose", lambda *_, **__: None)
    for name in ("gap_picture", "candidates_picture", "sizes_picture", "sizes_of", "write_diagnosed"):
        patch.setattr(diagnose_module, name, lambda *_, **__: None)


def result_of(root: Path, stage: str) -> StageResult:
    return read_result(out_of(root, stage), stage, site=None if stage in OF_CASE else "p1")


def recorded(root: Path, stage: str) -> set[str]:
    """Keys and roles that a result and its whole chain record."""
    links = result_of(root, stage).provenance["made_from"]
    earlier = [recorded(root, label.split()[0]) for label in links["results"]]
    return {*links["case"], *links["files"]}.union(*earlier)


def asked(key: tuple[str, str], names: set[str]) -> bool:
    """Whether the value of a key is among these names."""
    name = changed_keys.CHANGES[key][1]
    return name == "subject" or bool({name, f"site/p1/{name}"} & names)


def test_every_key_of_the_schema_has_another_value() -> None:
    assert set(changed_keys.CHANGES) == changed_keys.EVERY_KEY


@pytest.fixture(scope="module")
def noticed(made: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[tuple[str, str], str]]:
    """Of each stage the keys whose change breaks its result, and in which words."""
    case = tmp_path_factory.mktemp("changed") / "case"
    shutil.copytree(made / "case", case)
    results = {stage: result_of(made, stage) for stage in STAGES}
    found: dict[str, dict[tuple[str, str], str]] = {stage: {} for stage in STAGES}
    for key, (change, _) in changed_keys.CHANGES.items():
        changed_keys.write_changed(case, change)
        changed = Case.open(case)
        for stage, result in results.items():
            broken = Chain(changed, out_of(made, stage)).broken(result)
            if broken is not None:
                found[stage][key] = broken.what
    return found


@pytest.mark.parametrize("stage", list(STAGES))
def test_every_key_changed_after_a_stage_is_noticed_exactly_where_it_was_asked(
    made: Path, noticed: dict[str, dict[tuple[str, str], str]], stage: str
) -> None:
    names = recorded(made, stage)
    expected = {key for key in changed_keys.CHANGES if asked(key, names)}
    wrong = {key: noticed[stage].get(key, "not noticed") for key in expected ^ set(noticed[stage])}
    assert not wrong


# What the stages read, as seen by who knows them: the test of the record.
READ = {
    "segment": {"imaging", "subject/limb", "sites", "site/p1/place"},
    "mesh": {"probe", "model/margin", "model/element",
             "site/p1/long_axis", "site/p1/layers", "site/p1/fibres"},
    "build-feb": {"site/p1/levels", "site/p1/density_kg_per_m3"},
    "run": set(),
    "fit": {"site/p1/noise", "site/p1/states", "site/p1/swe_maps"},
}  # fmt: skip


def test_the_record_holds_what_each_stage_reads_and_no_more(made: Path) -> None:
    before: set[str] = set()
    for stage, more in READ.items():
        before |= more
        found = {each for each in recorded(made, stage) if not each.startswith("imaging/")}
        assert found == before, stage


def test_what_no_stage_asked_for_changes_no_result(made: Path, tmp_path: Path, monkeypatch) -> None:
    """All such keys changed at once: surfaces, mesh and model are the same."""
    stages = ("segment", "mesh", "build-feb")
    names = recorded(made, "build-feb")
    shutil.copytree(made / "case", tmp_path / "case")
    unread = [key for key in changed_keys.CHANGES if not asked(key, names)]
    alone = {
        ("site", "trace"),
        ("site", "swe_maps"),
        ("noise", "force_n"),
        ("probe", "name"),
        ("site", "skin_bone_mm"),
    }
    assert alone <= set(unread)
    of_sockets = [key for key in unread if key[0] in ("load_cell", "b_mode", "swe_images", "files")]

    def all_of_them(case: dict[str, Any]) -> None:
        for key in [*alone, *of_sockets]:
            changed_keys.CHANGES[key][0](case)

    changed_keys.write_changed(tmp_path / "case", all_of_them)
    chain_case.imaged(monkeypatch)
    case = Case.open(tmp_path / "case")
    for stage in stages:
        work, options = STAGES[stage]
        work(case, out=tmp_path / "out", **options)
        before, after = (result_of(each, stage).provenance["files_sha256"] for each in (made, tmp_path))
        assert before == after, stage


def test_values_that_were_given_otherwise_and_questions_for_checks_are_not_noted(tmp_path: Path) -> None:
    names: list[str] = []
    case = noting(chain_case.write_case(tmp_path / "case"), lambda name, _: names.append(name))
    site = with_values(case.site("p1"), position=(0.0, 0.0, 0.0), marker=None)
    assert (site.position, site.marker) == ((0.0, 0.0, 0.0), None)
    assert unnoted(site).levels.is_file()
    assert not names
    assert site.density_kg_per_m3 == 1000.0
    assert len(case.sites) == 1
    assert names == ["site/p1/density_kg_per_m3", "sites"]


def test_a_result_of_a_fixed_list_of_keys_is_judged_by_what_it_recorded(made: Path, tmp_path: Path) -> None:
    """An earlier limbcli recorded no files that the case does not name."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    path = tmp_path / "out" / "fit" / "p1" / "fit.json"
    content = json.loads(path.read_text())
    content["provenance"]["made_from"]["files"].pop("site/p1/swe_maps")
    path.write_text(json.dumps(sealed(content)))
    chain = Chain(Case.open(tmp_path / "case"), tmp_path / "out")
    assert chain.broken(result_of(tmp_path, "fit")) is None
    changed_keys.write_changed(tmp_path / "case", changed_keys.CHANGES["noise", "force_n"][0])
    broken = Chain(Case.open(tmp_path / "case"), tmp_path / "out").broken(result_of(tmp_path, "fit"))
    assert broken is not None
    assert broken.what.startswith("noise of site p1 changed")
