"""`limbcli run` and `limbcli build-feb` as a person or a script meets them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from limbcli.cli.app import main
from tests.stages.block_case import make_case

DATA = Path(__file__).resolve().parents[1] / "data" / "feb"


@pytest.fixture
def febio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    path = tmp_path / "febio4"
    path.write_text(f"#!/bin/sh\nexec '{sys.executable}' '{DATA / 'fake_febio.py'}' \"$@\"\n")
    path.chmod(0o755)
    return str(path)


def limbcli(*words: object) -> int:
    try:
        main([str(word) for word in words])
    except SystemExit as end:
        return int(end.code or 0)
    return 0


@pytest.mark.slow
def test_a_model_file_is_run_and_told_as_json(
    febio: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = limbcli("run", DATA / "punch.feb", "--febio", febio, "--out", tmp_path, "--json", "--quiet")
    shown = capsys.readouterr()
    assert code == 0
    assert json.loads(shown.out)["data"]["solver_version"] == "4.9.1"
    assert shown.err == ""
    assert limbcli("run", "--feb", DATA / "punch.feb", "--febio", febio, "--out", tmp_path) == 0
    shown = capsys.readouterr()
    assert "febio 4.9.1: 3 steps" in shown.out
    assert "solver: febio 4.9.1" in shown.err


def test_each_failure_has_its_exit_code_and_its_fix(
    febio: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    feb, out = DATA / "punch.feb", ["--out", tmp_path]
    assert limbcli("run", *out) == 2
    assert limbcli("run", tmp_path / "case", "--feb", feb, *out) == 2
    assert limbcli("run", tmp_path / "absent.feb", *out) == 2
    assert limbcli("run", feb, "--solver", "abaqus", *out) == 2
    assert limbcli("run", feb, "--febio", tmp_path / "absent", *out) == 4
    assert limbcli("run", feb, "--site", "p1", *out) == 2
    monkeypatch.setenv("FAKE_FEBIO", "failed")
    assert limbcli("run", feb, "--febio", febio, "--json", *out) == 6
    shown = capsys.readouterr()
    assert shown.err.count("fix:") == 7
    assert json.loads(shown.out)["facts"]["n_retries"] == 1


def test_a_case_is_built_and_run_by_its_commands(
    febio: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    depths = np.array([0.5, 1.2, 2.0])
    make_case(tmp_path / "case", out, depths, depths, c=0.005, build=False)
    assert limbcli("run", tmp_path / "case", "--out", out) == 2
    assert "limbcli build-feb" in capsys.readouterr().err
    assert limbcli("build-feb", tmp_path / "case", "--out", out, "--c-kpa", 6, "--m", 3, "--json") == 0
    data = json.loads(capsys.readouterr().out)[0]["data"]
    assert (data["c_kpa"], data["m"], data["f_kappa"]) == pytest.approx((6, 3, 100))
    assert limbcli("build-feb", tmp_path / "case", "--out", out, "--m", "-3") == 2
    assert limbcli("build-feb", tmp_path / "case", "--out", out, "--site", "p9") == 2
    assert "the sites are: p1" in capsys.readouterr().err


@pytest.mark.slow
def test_models_whose_names_differ_after_a_dot_have_folders_of_their_own(
    febio: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LIMBCLI_OUT", "results")
    for name in ("S1.v1.feb", "S1.v2.feb"):
        (tmp_path / name).write_bytes((DATA / "punch.feb").read_bytes())
        assert limbcli("run", name, "--febio", febio) == 0
    assert sorted(each.name for each in (tmp_path / "results").iterdir()) == ["S1.v1", "S1.v2"]


def test_what_would_not_be_heard_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").mkdir()
    subject = tmp_path / "subject"
    assert limbcli("phantom", subject, "--no-measurement", "--noise", "0") == 2
    assert limbcli("phantom", subject, "--id", "a b/c") == 2
    assert "use letters" in capsys.readouterr().err
    assert limbcli("report", "--index", tmp_path / "out", "--out", tmp_path / "other") == 2
    assert not subject.exists()
