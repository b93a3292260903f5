"""A stage that is killed, whenever that is, leaves nothing that the next call does not put right.

One moment a stage; `tests/benchmarks/kills.py` tries many.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import meshio
import numpy as np
import pytest

from limbcli.cli.app import main
from limbcli.files.atomic import sha256
from limbcli.results import read_result
from tests.stages.test_mesh import CASE, prism

STAGES = (
    ("segment", None, ()),
    ("mesh", "p1", ("--site", "p1", "--size-mm", "7", "--far-size-mm", "14")),
    ("build-feb", "p1", ("--site", "p1")),
    ("run", "p1", ("--site", "p1", "--solver", "reference")),
)
TIMED = {"log", "progress"}  # files that tell how long something took


@pytest.fixture
def case(tmp_path: Path) -> Path:
    folder = tmp_path / "case"
    folder.mkdir()
    for name, body in (("skin", prism(30.0, -60, 60)), ("tibia", prism(9.0, -70, 70, x=4.0))):
        meshio.Mesh(body.points, [("triangle", body.faces)]).write(folder / f"{name}.ply")
    (folder / "levels.csv").write_text("force_n,depth_mm,swe_mean_m_per_s\n0,0,1.6\n1,1,1.7\n2,2,1.9\n")
    (folder / "case.toml").write_text(CASE)
    return folder


def words(case: Path, out: Path, stage: str, options: tuple[str, ...]) -> list[str]:
    return [stage, str(case), "--out", str(out), "--quiet", *options]


def finished(case: Path, out: Path, stage: str, options: tuple[str, ...]) -> float:
    """The command, undisturbed and in this process; seconds."""
    begin = time.perf_counter()
    with pytest.raises(SystemExit) as stop:
        main(words(case, out, stage, options))
    assert not stop.value.code
    return time.perf_counter() - begin


def killed(case: Path, out: Path, stage: str, options: tuple[str, ...], *, after: float) -> None:
    """The command, killed so many seconds after it began to write."""
    before = set(out.rglob("*"))
    command = [sys.executable, "-m", "limbcli", *words(case, out, stage, options)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and set(out.rglob("*")) == before:
        time.sleep(0.02)
    time.sleep(after)
    process.kill()
    process.wait(timeout=60)


def kept(out: Path, stage: str, site: str | None) -> dict[str, str]:
    """Hashes of what the stage left."""
    result = read_result(out, stage, site=site)
    return {name: sha256(result.path(name)) for name in result.files if name not in TIMED}


@pytest.mark.slow
def test_the_same_command_again_gives_what_an_undisturbed_one_gives(case: Path, tmp_path: Path):
    rng = np.random.default_rng(7)
    whole, disturbed = tmp_path / "whole", tmp_path / "disturbed"
    for stage, site, options in STAGES:
        took = finished(case, whole, stage, options)
        killed(case, disturbed, stage, options, after=rng.uniform(0.0, 0.8) * took)
        finished(case, disturbed, stage, options)
        assert kept(disturbed, stage, site) == kept(whole, stage, site), stage
    names = {str(path.relative_to(whole)) for path in whole.rglob("*")}
    assert {str(path.relative_to(disturbed)) for path in disturbed.rglob("*")} == names
