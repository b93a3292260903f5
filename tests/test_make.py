"""`make cases` hands any folders to one batch."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

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
