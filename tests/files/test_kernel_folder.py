"""Compiled kernels lie where they can be written, and a change of any source is another folder."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from limbcli.files import kernel_folder
from limbcli.files.kernel_folder import VARIABLE, keep_kernels

ROOT = Path(kernel_folder.__file__).parents[2]
# A kernel, and a function in another file that it calls.
CALLED = "from numba import njit\n@njit(cache=True)\ndef twice(x):\n    return {factor} * x\n"
CALLER = """
from pathlib import Path
from limbcli.files.kernel_folder import keep_kernels
keep_kernels(Path(__file__).parent)
from numba import njit
from called import twice
@njit(cache=True)
def answer(x):
    return twice(x) + 1.0
print(answer(1.0))
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package that could be written, of a user whose home and temporary folder are here, too."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setitem(sys.modules, "numba", None)  # type: ignore[arg-type]
    monkeypatch.delitem(sys.modules, "numba")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    package = tmp_path / "package"
    (package / "materials").mkdir(parents=True)
    (package / "materials" / "law.py").write_text("njit")
    return package


def read_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_folder.os, "access", lambda *_: False)


def test_a_package_that_can_be_written_keeps_them_beside_the_sources(package: Path):
    assert keep_kernels(package) is None
    assert VARIABLE not in os.environ


def test_one_that_cannot_keeps_them_in_the_users_cache(package: Path, monkeypatch: pytest.MonkeyPatch):
    read_only(monkeypatch)
    first = keep_kernels(package)
    assert first is not None
    assert first.parent == package.parent / "cache" / "limbcli"
    assert os.environ[VARIABLE] == str(first)
    assert keep_kernels(package) == first, "as a child process finds it"
    (package / "materials" / "law.py").write_text("njit, another")
    second = keep_kernels(package)
    assert second is not None
    assert second != first
    assert second.parent == first.parent


def test_without_a_home_they_lie_in_a_temporary_folder_that_is_nobody_elses(
    package: Path, monkeypatch: pytest.MonkeyPatch
):
    read_only(monkeypatch)
    (package.parent / "cache").write_text("in the way")
    first = keep_kernels(package)
    assert first is not None
    assert first.parent == package.parent / "tmp"
    assert first.stat().st_mode & 0o077 == 0
    first.chmod(0o777)  # anybody may have put something there
    monkeypatch.delenv(VARIABLE)
    assert keep_kernels(package) not in (None, first)


@pytest.mark.slow
def test_a_changed_function_in_another_file_is_not_served_from_a_named_folder(tmp_path: Path):
    (tmp_path / "caller.py").write_text(CALLER)
    answers = []
    for factor in (2.0, 15.0):  # sources of two lengths: bytecode is kept by second and length
        (tmp_path / "called.py").write_text(CALLED.format(factor=factor))
        run = subprocess.run(
            [sys.executable, tmp_path / "caller.py"], capture_output=True, text=True, check=True,
            env={**os.environ, VARIABLE: str(tmp_path / "kernels"), "PYTHONPATH": str(ROOT)}, timeout=100,
        )  # fmt: skip
        answers.append(float(run.stdout))
    assert answers == [3.0, 16.0]
