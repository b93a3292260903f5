"""Whatever goes wrong ends in a message with a way out: no traceback on the terminal."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from limbcli.cli.app import main
from tests.stages.chain_case import write_case

pytestmark = pytest.mark.slow

FAULTY = """
import sys
from limbcli.cli import entry
from limbcli.cli import command_functions as command
import limbcli.stages.segment as module
def broken(*_, **__):
    raise ZeroDivisionError("of all things")
module.segment = broken
sys.argv = ["limbcli", *sys.argv[1:]]
entry.main()
"""


def faulty(*arguments: str, temporary: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", FAULTY, *arguments]
    environment = {**os.environ, "TMPDIR": str(temporary)}
    return subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)


def test_a_terminal_without_greek_letters_gets_them_spelt():
    """As with the locale de_DE.ISO-8859-1 of an old cluster."""
    code = (
        "import limbcli.cli.app as a, limbcli.cli.entry as e; a.main = lambda: print('f_\\u03ba'); e.main()"
    )
    environment = {**os.environ, "PYTHONIOENCODING": "latin-1"}
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60, env=environment)
    assert (found.returncode, found.stdout) == (0, b"f_\\u03ba\n"), found.stderr


@pytest.mark.parametrize("there", [True, False], ids=["output folder", "no output folder"])
def test_what_nobody_foresaw_is_a_message_with_a_file_to_send_in(tmp_path: Path, there: bool):
    write_case(tmp_path / "case")
    (tmp_path / "temporary").mkdir()
    out = tmp_path / "out"
    if there:
        out.mkdir()
    done = faulty(
        "segment", str(tmp_path / "case"), "--out", str(out if there else tmp_path / "none" / "x"), "--json",
        temporary=tmp_path / "temporary",
    )  # fmt: skip
    assert done.returncode == 70
    assert "Traceback" not in done.stdout + done.stderr
    assert "unexpected error occurred in limbcli (ZeroDivisionError: of all things)" in done.stderr
    reported = json.loads(done.stdout)
    assert (reported["error"], reported["exit_code"]) == ("UnforeseenError", 70)
    story = Path(reported["where"])
    assert story.name.startswith("limbcli-error-")
    assert "ZeroDivisionError" in story.read_text()
    assert "limbcli segment" in story.read_text()


def limited() -> None:
    """No file may grow beyond 2 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))


def limbcli(*arguments: str, **more: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-B", "-m", "limbcli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **more)  # type: ignore[call-overload]


def test_a_full_disk_is_told(tmp_path: Path):
    write_case(tmp_path / "case")
    done = limbcli("report", str(tmp_path / "case"), "--out", str(tmp_path / "out"), preexec_fn=limited)
    assert done.returncode == 4, done.stderr
    assert "the disk is full" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out" / "report").exists()


@pytest.mark.parametrize("command", ["report", "segment", "batch", "mesh"])
def test_a_file_as_output_folder_is_told(tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]):
    write_case(tmp_path / "case")
    out = tmp_path / "out"
    out.write_text("mine")
    with pytest.raises(SystemExit) as stop:
        main([command, str(tmp_path / "case"), "--out", str(out)])
    reported = capsys.readouterr().err
    assert stop.value.code == 2, reported
    assert "Traceback" not in reported
    assert "out" in reported
    assert out.read_text() == "mine"


def test_one_cases_unforeseen_fault_does_not_stop_the_batch(tmp_path: Path):
    for name in ("a", "b"):
        write_case(tmp_path / name)
    (tmp_path / "temporary").mkdir()
    done = faulty(
        "batch", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "out"), "--jobs", "1",
        temporary=tmp_path / "temporary",
    )  # fmt: skip
    assert done.returncode == 70
    assert "2 of 2 cases failed" in done.stderr
    reported, listed = done.stderr.split("2 of 2 cases failed:")
    assert reported.count("of all things") == listed.count("of all things") == 2
    assert "Traceback" not in done.stderr
