"""What the environment says: the most threads, the output folder, the home folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from limbcli.api.call import folder_of
from limbcli.cli.app import main
from limbcli.config import THREADS, at_most, available_cores, default_out
from limbcli.errors import CaseError


def test_threads_are_at_most_those_that_the_environment_allows(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv(THREADS, raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert at_most(2) == 2
    for values, allowed in (("1", 1), ("8", 2), ("0", 1), ("many", 2), ("", 2)):
        monkeypatch.setenv(THREADS, values)
        assert at_most(2) == allowed
    monkeypatch.setenv(THREADS, "1")
    assert available_cores() == 1


def test_what_is_said_to_all_programs_holds_where_this_one_is_told_nothing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv(THREADS, raising=False)
    for values, allowed in (("1", 1), ("1,4", 1), ("8", 2), ("0", 1), ("FALSE", 2), ("", 2)):
        monkeypatch.setenv("OMP_NUM_THREADS", values)
        assert at_most(2) == allowed
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv(THREADS, "2")
    assert at_most(2) == 2


def test_an_output_folder_that_is_left_empty_is_the_usual_one(monkeypatch: pytest.MonkeyPatch):
    """`LIMBCLI_OUT=$SCRATCH` of a job without that variable: results do not go among the measurements."""
    monkeypatch.setenv("LIMBCLI_OUT", "")
    assert default_out(Path("cases/S1")) == Path("out/S1")
    monkeypatch.setenv("LIMBCLI_OUT", "elsewhere")
    assert default_out(Path("cases/S1")) == Path("elsewhere/S1")


def test_a_tilde_is_the_home_folder_wherever_a_path_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("LIMBCLI_OUT", "~/out")
    assert folder_of("~/results") == tmp_path / "home/results"
    assert default_out(Path("S1")) == tmp_path / "home/out/S1"
    with pytest.raises(SystemExit):
        main(["check", "~/nowhere"])
    assert str(tmp_path / "home/nowhere") in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["report", "--index=~/nowhere"])
    assert str(tmp_path / "home/nowhere") in capsys.readouterr().err
    with pytest.raises(CaseError, match="~nobody-of-that-name"):
        folder_of("~nobody-of-that-name/results")
    assert "~" not in os.listdir(tmp_path)
