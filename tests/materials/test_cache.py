"""Compiled loops on disk go when the source of anything they call has changed."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from limbcli.materials import cache


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the sources, with a cached loop in every folder, stamped."""
    here = Path(cache.__file__).parent.parent
    for name in ("materials", "fem"):
        shutil.copytree(here / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(cache, "__file__", str(tmp_path / "materials" / "cache.py"))
    cache.drop_stale_kernels()
    for name in ("materials", "fem", "fem/elements", "fem/linear_solvers/multifrontal"):
        (tmp_path / name / "__pycache__").mkdir(exist_ok=True)
        (tmp_path / name / "__pycache__" / "old.nbi").touch()
    return tmp_path


def cached(package: Path) -> int:
    return len(list(package.rglob("*.nbi")))


def test_what_is_unchanged_stays(package: Path) -> None:
    assert not cache.drop_stale_kernels()
    assert cached(package) == 4


@pytest.mark.parametrize(
    "name",
    [
        "materials/ogden.py",
        "materials/simd.py",
        "fem/elements/kernels.py",
        "fem/linear_solvers/multifrontal/dense.py",
    ],
)
def test_a_change_of_a_source_drops_them_all(package: Path, name: str) -> None:
    path = package / name
    path.write_text(path.read_text() + "\n# changed\n")
    assert cache.drop_stale_kernels()
    assert cached(package) == 0
    assert not cache.drop_stale_kernels(), "once"
