"""`make cases` hands any folders to one batch; `make demo` ends with what the diagnosis said."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from limbcli.results import StageResult

REPOSITORY = Path(__file__).resolve().parents[1]


def cases(*words: str) -> subprocess.CompletedProcess[str]:
    """What `make cases` would call, a word a line."""
    if shutil.which("make") is None:
        pytest.skip("needs make")
    command = ["make", "-s", "-o", "env", "cases", r"LIMBCLI=printf %s\\n", *words]
    return subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=60)


def test_any_paths_are_given_to_one_batch_and_what_is_no_folder_is_left_out(tmp_path: Path):
    for name in ("a", "b c"):
        (tmp_path / "my limbs" / name).mkdir(parents=True)
    (tmp_path / "my limbs" / "README.md").touch()
    done = cases(f"CASES='{tmp_path}/my limbs'/*", "JOBS=3")
    folders = [str(tmp_path / "my limbs" / name) for name in ("a", "b c")]
    assert done.stdout.splitlines() == ["batch", *folders, "--expect", "--jobs", "3"]


def test_without_paths_it_is_the_cases_of_the_repository():
    found = sorted(path.parent.relative_to(REPOSITORY) for path in REPOSITORY.glob("cases/*/case.toml"))
    assert found
    assert cases().stdout.splitlines() == ["batch", *map(str, found), "--expect"]


def test_no_folder_at_all_is_told(tmp_path: Path):
    done = cases(f"CASES={tmp_path}/none/*")
    assert done.returncode != 0
    assert f"there is no case folder in {tmp_path}/none/*" in done.stdout


def test_the_demo_says_at_its_end_what_was_hidden_and_what_was_named(tmp_path: Path):
    if shutil.which("make") is None:
        pytest.skip("needs make")
    for name in ("subject/truth", "results/report"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "subject/truth/truth.toml").write_text('[[hidden]]\neffect = "skin-layer"\n')
    summary = [
        "p1: fine",
        "p1: diagnosis: skin-layer (named); the gap went from 1.47 to 0.92",
        "page: x",
    ]
    report = StageResult("report", "S1", tmp_path, summary=tuple(summary))
    (tmp_path / "results/report/report.json").write_text(json.dumps(report.to_json(), indent=1))
    command = ["make", "-s", "-o", "env", "demo", "LIMBCLI=true", f"DEMO={tmp_path}"]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=True)
    hidden, named, page = done.stdout.splitlines()
    assert hidden.endswith(" skin-layer")
    assert named.endswith(" skin-layer (named); the gap went from 1.47 to 0.92")
    assert page.endswith(f" {tmp_path}/results/report/report.html")
