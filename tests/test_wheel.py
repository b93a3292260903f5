"""What an installed wheel can do, away from the repository."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.stages import block_case

REPOSITORY = Path(__file__).resolve().parents[1]


def run(*command: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {
        k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "LIMBCLI", "VIRTUAL_ENV"))
    }
    environment["LIMBCLI_THREADS"] = "1"  # no kernels are compiled ahead: no simulation follows
    result = subprocess.run(
        [str(each) for each in command], cwd=cwd, env=environment, capture_output=True, text=True, timeout=560
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(
        sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, REPOSITORY, cwd=folder
    )
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`limbcli` of a fresh environment: the wheel is installed, its dependencies are lent by this one."""
    folder = tmp_path_factory.mktemp("fresh")
    run(sys.executable, "-m", "venv", "--without-pip", folder / "env", cwd=folder)
    pip = [sys.executable, "-m", "pip", "--python", folder / "env" / "bin" / "python"]
    run(*pip, "install", "--quiet", "--no-deps", "--no-index", wheel, cwd=folder)
    site = next((folder / "env" / "lib").glob("python*/site-packages"))
    # A path inside a .pth file is searched, but its own .pth files (the editable install) are not.
    (site / "lent.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "env" / "bin" / "limbcli"


@pytest.mark.slow
def test_wheel_carries_the_templates_and_no_tests(wheel: Path):
    names = zipfile.ZipFile(wheel).namelist()
    assert any(name.startswith("limbcli/_templates/feb/") for name in names)
    assert any(name.startswith("limbcli/_templates/report/") for name in names)
    assert "limbcli/py.typed" in names  # the package's types are for those who use it, too
    files = (each for each in (REPOSITORY / "limbcli").rglob("*") if each.is_file())
    kept = {each.relative_to(REPOSITORY).as_posix() for each in files if "__pycache__" not in each.parts}
    assert kept <= set(names)
    assert not [name for name in names if "tests" in name.split("/")]


@pytest.mark.slow
def test_installed_wheel_makes_model_and_report(installed: Path, tmp_path: Path):
    """By its templates. The other stages compile their kernels anew there, and need no further file."""
    depths = np.array([1.0, 2.0])
    block_case.make_case(tmp_path / "case", tmp_path / "out", depths, depths**2, c=0.008, build=False)
    script = "import limbcli; print(limbcli.__file__); limbcli.build_feb('case', out='out')"
    where = run(installed.parent / "python", "-c", script, cwd=tmp_path)
    assert str(installed.parents[1]) in where.stdout, "the repository was imported, not the wheel"
    run(installed, "report", "case", "--out", "out", cwd=tmp_path)
    assert (tmp_path / "out" / "report" / "report.html").is_file()
    assert list((tmp_path / "out" / "build-feb").glob("*/model.feb"))
