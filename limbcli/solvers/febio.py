"""FEBio as a solver: locates, runs, monitors and stops it, and evaluates its log."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TextIO

from limbcli.errors import CaseError, LimbError, SolveError, ToolError
from limbcli.feb.log import LogReader, check_complete, quote, read_log, warning_box
from limbcli.feb.log_identity import check_belongs, marked
from limbcli.feb.outline import Outline, check_output, read_outline
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.files.atomic import sha256
from limbcli.files.temporary_folders import ends_with_this_process
from limbcli.model import LimbModel
from limbcli.progress import Progress
from limbcli.solvers.febio_watch import HEARTBEAT_S, LogWatcher, default_limit_s
from limbcli.solvers.law_check import can_be_checked, check_first_step
from limbcli.solvers.record_tables import read_finished, read_tables
from limbcli.solvers.solver import LOG_FILE, MODEL_FILE, Simulation
from limbcli.solvers.untouched import is_without_force, logged_poses, without_force

BINARIES = ("febio4", "febio")
VARIABLE = "LIMBCLI_FEBIO"
_POLL_S = 0.1
_GRACE_S = 3.0
LINGERS_S = 10.0  # seconds after its log reports the end of the run before a lingering process is stopped
_VERSION_TIMEOUT_S = 5.0
_VERSION_BYTES = 20_000
_SCREEN_FILE = "febio-screen.txt"
_LEFTOVERS = (".xplt", ".dmp")  # plot and restart files, deleted: large and not used


@dataclass
class FebioSolver:
    """FEBio 4 behind the common solver interface.

    binary : executable to run; None: the variable LIMBCLI_FEBIO, then `febio4`, `febio` on PATH
    threads : OpenMP threads; None: OMP_NUM_THREADS, else all processors
    keep_plot : keep FEBio's plot file of a finished run beside the log, named as the model (.xplt)
    """

    binary: Path | None = None
    threads: int | None = None
    keep_plot: bool = False
    name: str = "febio"

    def path(self) -> Path | None:
        """The executable that would be run, or None."""
        named = self._named()
        if named is not None and named.is_file():
            return named.resolve() if os.access(named, os.X_OK) else None
        for each in BINARIES if named is None else [str(named)]:
            found = shutil.which(each)
            if found:
                return Path(found).resolve()
        return None

    def _named(self) -> Path | None:
        """The binary named here or in the environment: a file path, or the name of a program on PATH."""
        named = self.binary or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
        return named.expanduser() if named is not None else None

    def found(self) -> bool:
        return self.path() is not None

    def version(self) -> str:
        """The version that FEBio prints ("4.11.0"); "unknown" if none appears within 5 s. Logs state it too.

        Raises ToolError if there is no FEBio, or it cannot be started.
        """
        binary = self.need()
        try:
            process = subprocess.Popen(
                [str(binary), "-info"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            raise _not_startable(binary, error) from error
        timer = time.monotonic() + _VERSION_TIMEOUT_S
        assert process.stdout is not None
        if not hasattr(os, "set_blocking"):  # Windows before Python 3.12
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_VERSION_TIMEOUT_S)
            _stop(process)
            with process.stdout:
                return _version_in(process.stdout.read(_VERSION_BYTES))
        os.set_blocking(process.stdout.fileno(), False)
        seen = b""
        while len(seen) < _VERSION_BYTES and time.monotonic() < timer:
            ended = process.poll() is not None
            seen += process.stdout.read() or b""
            if ended:
                break
            time.sleep(_POLL_S / 4)
        _stop(process)
        process.stdout.close()
        return _version_in(seen[:_VERSION_BYTES])

    def identity(self) -> str:
        """Hash of the binary and the version it reports; the latter because its libraries are separate files.

        Raises ToolError as `version`.
        """
        binary = self.need()
        found = binary.stat()
        return _identity(binary, found.st_mtime_ns, found.st_size)

    def write(self, model: LimbModel, folder: Path) -> Path:
        return write_feb(model, folder / MODEL_FILE)

    def run(self, feb: Path, *, progress: Progress, time_limit_s: float | None = None) -> None:
        """Run a model file in its folder; the log and the record files are written next to it.

        time_limit_s : None: from the model's size (`default_limit_s`)

        Raises CaseError if FEBio would write no records of the model, or unconverged ones; ToolError if there
        is no FEBio, or it cannot be started; SolveError if the time limit is exceeded, or FEBio's log does
        not report that the end of the load of this model was reached, regardless of the exit status.
        """
        outline = read_outline(feb)
        check_output(outline, feb)
        log = feb.parent / LOG_FILE
        for stale in [log, *(feb.parent / record.file for record in outline.records)]:
            stale.unlink(missing_ok=True)
        limit = default_limit_s(outline) if time_limit_s is None else time_limit_s
        shown, plot = feb.parent / _SCREEN_FILE, marked(feb, _LEFTOVERS[0])
        with shown.open("w+", errors="replace") as screen:
            process = self._start(feb, plot, screen)
            try:
                _watch(process, LogWatcher(log, outline, progress), limit, given=time_limit_s is not None)
            finally:
                _stop(process)
                if self.keep_plot and (feb.parent / plot).is_file():
                    (feb.parent / plot).replace(feb.parent / plot_file(feb))
                for name in (*(feb.stem + ending for ending in _LEFTOVERS), plot):
                    if self.keep_plot and name == plot_file(feb):
                        continue
                    (feb.parent / name).unlink(missing_ok=True)
            _judge(log, outline, process.returncode, screen)
        check_belongs(log, feb, outline, by_mark=True)
        shown.unlink()
        _say_untouched(feb, outline, log, progress)

    def read(self, feb: Path) -> Simulation:
        """The results of a finished run, whose stresses must agree with the model's laws (`law_check`)."""
        simulation = read_finished(self.name, feb)
        if can_be_checked(simulation.elements):
            with contextlib.suppress(CaseError):  # a model with features unknown to limbcli is not checked
                check_first_step(read_feb(feb), simulation.elements, feb.parent)
        return simulation

    def need(self) -> Path:
        """The executable; raises ToolError, listing the places searched, if there is none."""
        path = self.path()
        if path is None:
            named = self._named()
            what = f"FEBio was not found at {named}" if named else "FEBio was not found"
            if named is not None and named.exists():
                what = f"{named} is a folder" if named.is_dir() else f"{named} is not executable"
            raise ToolError(
                what,
                where=f"--febio, {VARIABLE}, then {' and '.join(BINARIES)} on PATH",
                fix="install FEBio 4 (https://febio.org) and give its binary with --febio FILE, "
                "or use --solver reference",
            )
        return path

    def _start(self, feb: Path, plot: str, screen: TextIO) -> subprocess.Popen[bytes]:
        binary = self.need()
        threads = str(self.threads or os.environ.get("OMP_NUM_THREADS") or os.cpu_count() or 1)
        environment = {**os.environ, "OMP_NUM_THREADS": threads, "MKL_NUM_THREADS": threads}
        try:
            return subprocess.Popen(
                [str(binary), "-i", feb.name, "-o", LOG_FILE, "-p", plot],
                cwd=feb.parent,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=screen,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=ends_with_this_process(),
            )
        except OSError as error:
            raise _not_startable(binary, error) from error


def _version_in(printed: bytes) -> str:
    reader = LogReader()
    for line in printed.decode(errors="replace").splitlines():
        reader.feed(line)
    return reader.version or "unknown"


def plot_file(feb: Path) -> str:
    """Name of the plot file that is kept.

    >>> plot_file(Path("model.feb"))
    'model.xplt'
    """
    return feb.stem + _LEFTOVERS[0]


def _say_untouched(feb: Path, outline: Outline, log: Path, progress: Progress) -> None:
    """Add a warning to FEBio's log if no rigid body of a model with contact had a force in any step."""
    rigid = tuple(each for each in outline.records if each.kind == "rigid_body")
    with contextlib.suppress(LimbError):  # what limbcli cannot read is not examined
        tables = read_tables(replace(outline, records=rigid), feb.parent).rigid
        if not is_without_force(tables):
            return
        model = read_feb(feb)
        for sentence in without_force(model, logged_poses(model, tables)):
            progress.event("note", text=sentence)
            with log.open("a", encoding="utf-8") as stream:
                stream.write(warning_box(sentence))


@cache
def _identity(binary: Path, changed_ns: int, size: int) -> str:
    """Identity string, cached per process while the file is unchanged; an unreadable file is identified by
    size and modification time."""
    try:
        content = sha256(binary)
    except PermissionError:
        content = f"{size} bytes of {changed_ns}"
    return f"febio {FebioSolver(binary).version()} {content}"


def _not_startable(binary: Path, error: OSError) -> ToolError:
    return ToolError(
        f"FEBio cannot be started ({error.strerror})",
        where=str(binary),
        fix="check that the file is FEBio for this machine and is executable",
    )


def _stop(process: subprocess.Popen[bytes]) -> None:
    """Stop the process group, if still running: SIGTERM first, then SIGKILL; the process alone on Windows."""
    if process.poll() is not None:
        return
    if not hasattr(os, "killpg"):
        process.kill()
        process.wait(timeout=_GRACE_S)
        return
    for wish in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, wish)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=_GRACE_S)


def _watch(process: subprocess.Popen[bytes], watcher: LogWatcher, limit_s: float, *, given: bool) -> None:
    """Follow the log until the process ends, reporting a heartbeat while the log is silent.

    A process that does not exit although its log reports the end of the run is stopped.
    """
    start = last_sign = time.monotonic()
    while process.poll() is None:
        now = time.monotonic()
        if watcher.look():
            last_sign = now
        elif watcher.reader.ending != "none" and now - last_sign > LINGERS_S:
            _stop(process)
        elif now - last_sign > HEARTBEAT_S:
            watcher.alive(now - start, limit_s)
            last_sign = now
        if now - start > limit_s:
            _stop(process)
            watcher.look()
            whose = "" if given else " (the limit for a model of this size)"
            raise SolveError(
                f"FEBio was stopped after {limit_s:g} s{whose}, at time {watcher.reached():g} "
                f"and iteration {watcher.reader.result().n_iterations}",
                where=str(watcher.log),
                fix="allow more time with --time-limit-s, or use --element tet4 or --solver reference",
                time_reached=watcher.reached(),
            )
        time.sleep(_POLL_S)
    watcher.look()


def _judge(log: Path, outline: Outline, status: int | None, screen: TextIO) -> None:
    """Check completion by the log; without a log, raise SolveError quoting FEBio's screen output."""
    if log.is_file():
        check_complete(read_log(log), log, end_time=outline.end_time)
        return
    screen.seek(0)
    lines = [line.strip() for line in screen.read().splitlines() if line.strip()][-12:]
    raise SolveError(
        f"FEBio ended with status {status} and wrote no log. It printed:\n{quote(lines)}",
        where=str(log),
        fix="start FEBio manually on the model file next to it; check its installation and licence",
        status=status,
    )
