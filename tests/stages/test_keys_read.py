"""Keys that a stage reads, noted while it runs: a change is noticed exactly where it matters."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from limbcli.case import Case
from limbcli.results import read_result
from limbcli.stages.build_feb import build_feb
from limbcli.stages.mesh import mesh
from limbcli.stages.provenance.chain import Chain
from limbcli.stages.segment import segment
from tests.stages import chain_case, changed_keys
from tests.stages.noting_case import noting

pytestmark = pytest.mark.slow

STAGES: dict[str, Any] = {
    "segment": (segment, {}),
    "mesh": (mesh, chain_case.SIZES),
    "build-feb": (build_feb, {}),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, dict[str, set[str]]]]:
    """The folder of case and results, and what each stage asked of the case."""
    root = tmp_path_factory.mktemp("keys")
    case = chain_case.write_case(root / "case")
    asked: dict[str, dict[str, set[str]]] = {}
    with pytest.MonkeyPatch.context() as patch:
        chain_case.imaged(patch)
        for stage, (run, options) in STAGES.items():
            mine, found = noting(case)
            run(mine, out=root / "out", **options)
            asked[stage] = found.keys
    return root, asked


# What a stage asks for its warnings and checks only: its result stays valid.
ONLY_CHECKS = {
    "mesh": {"site/p1/levels", "site/p1/skin_bone"},
    "build-feb": {"site/p1/noise", "site/p1/skin_bone"},
}


def recorded(out: Path, stage: str) -> tuple[set[str], set[str]]:
    """(keys that a result records itself, keys and roles of its whole chain)."""
    found = read_result(out, stage, site=None if stage == "segment" else "p1")
    links = found.provenance["made_from"]
    earlier = [recorded(out, label.split()[0])[1] for label in links["results"]]
    return set(links["case"]), {*links["case"], *links["files"]}.union(*earlier)


@pytest.mark.parametrize("stage", list(STAGES))
def test_what_a_stage_asks_of_the_case_is_recorded_and_nothing_else(made: Any, stage: str) -> None:
    root, asked = made
    own, chain = recorded(root / "out", stage)
    unrecorded = {key: by for key, by in asked[stage].items() if key not in chain}
    assert set(unrecorded) == ONLY_CHECKS.get(stage, set()), unrecorded
    assert own - set(asked[stage]) <= {"sites"}


def test_every_key_of_the_schema_has_another_value() -> None:
    assert set(changed_keys.CHANGES) == changed_keys.EVERY_KEY


@pytest.mark.parametrize("stage", list(STAGES))
def test_every_key_changed_after_a_stage_is_noticed_exactly_where_it_was_asked(
    made: Any, tmp_path: Path, stage: str
) -> None:
    root, asked = made
    order = list(STAGES)
    earlier = order[: order.index(stage) + 1]
    matters = set().union(*(set(asked[each]) - ONLY_CHECKS.get(each, set()) for each in earlier))
    result = read_result(root / "out", stage, site=None if stage == "segment" else "p1")
    shutil.copytree(root / "case", tmp_path / "case")
    wrong = {}
    for key, (change, name) in changed_keys.CHANGES.items():
        changed_keys.write_changed(tmp_path / "case", change)
        broken = Chain(Case.open(tmp_path / "case"), root / "out").broken(result)
        expected = name == "subject" or bool({name, f"site/p1/{name}"} & matters)
        if (broken is not None) != expected:
            wrong[key] = broken.what if broken else "not noticed"
    assert not wrong
