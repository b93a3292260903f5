"""What only POSIX systems have is not needed."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "limbcli"
POSIX_MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "pty", "tty", "syslog", "posix"}

# As Windows: what it lacks is taken away after the libraries have taken their own choice.
WITHOUT = """
import importlib, os, pkgutil, signal, sys
import matplotlib, numba, numpy, portalocker, scipy, typer
for name in ("getuid", "geteuid", "killpg", "O_DIRECTORY", "O_NOFOLLOW", "sched_getaffinity", "set_blocking"):
    if hasattr(os, name):
        delattr(os, name)
del signal.SIGKILL
sys.modules["fcntl"] = None
import limbcli
for found in pkgutil.walk_packages(limbcli.__path__, "limbcli."):
    if not found.name.endswith(("__main__", "kernels")):
        importlib.import_module(found.name)
from pathlib import Path
from limbcli.files.output_lock import one_writer
from limbcli.files.temporary_folders import scratch_folder
from limbcli.files.kernel_folder import _places
with scratch_folder() as folder, one_writer(folder / "out"):
    (folder / "out" / "a.txt").write_text("a")
assert not folder.exists()
assert [*_places("limbcli-kernels-test")]
from limbcli.config import available_cores
from limbcli.solvers.febio import FebioSolver, _stop
import subprocess
signal.SIGKILL = 9  # of the subprocess module of this system
binary = Path(sys.argv[1])
assert FebioSolver(binary).version() == "4.11.0", FebioSolver(binary).version()
running = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
_stop(running)
assert running.returncode is not None
print("all", available_cores())
"""


def test_no_module_of_posix_alone_is_imported():
    found = []
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if any(each in text for each in POSIX_MODULES) else ():
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            found += [f"{path.name}: {each}" for each in names if each in POSIX_MODULES]
    assert not found


@pytest.mark.slow
def test_everything_is_imported_and_locks_hold_without_what_windows_lacks(tmp_path: Path):
    febio = tmp_path / "febio4"
    febio.write_text("#!/bin/sh\necho 'version 4.11.0'\n")
    febio.chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, str(febio)],
        capture_output=True, text=True, timeout=300, env={"TMPDIR": str(tmp_path), "HOME": str(tmp_path),
        "PYTHONPATH": ":".join(each for each in sys.path if each), "PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("all")
