"""With --json nothing but our JSON reaches stdout, whatever a library prints, and none ends the process."""

from __future__ import annotations

import json
import subprocess
import sys

NOISY = """
import ctypes, os, sys
import limbcli.stages.check as stage
from limbcli.cli.entry import main

def noisy(*arguments, **options):
    print("words of Python")
    libc = ctypes.CDLL(None)
    libc.puts(b"words of C")
    libc.fflush(None)
    os.system("echo words of a child")
    {then}

real = stage.check
stage.check = noisy
sys.argv = ["limbcli", "check", {folder!r}, *{options!r}]
main()
"""


def run(tmp_path, then: str, *options: str) -> subprocess.CompletedProcess[str]:
    (tmp_path / "case.toml").write_text("format = 1\n")
    code = NOISY.format(then=then, folder=str(tmp_path), options=list(options))
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path
    )


def test_what_a_library_prints_goes_to_stderr(tmp_path):
    found = run(tmp_path, "return real(*arguments, **options)", "--json")
    assert json.loads(found.stdout)["problems"]
    for origin in ("Python", "C", "a child"):
        assert f"words of {origin}" in found.stderr


def test_a_library_that_ends_the_process_is_an_error_in_words(tmp_path):
    found = run(tmp_path, "sys.exit(1)", "--json")
    assert found.returncode == 70
    assert json.loads(found.stdout)["exit_code"] == 70
    assert "a library ended the process" in found.stderr
