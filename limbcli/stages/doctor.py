"""doctor: test (not only look up) whether this machine has what limbcli needs."""

from __future__ import annotations

import os
import platform
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from packaging.requirements import Requirement

from limbcli.config import cores, templates_folder
from limbcli.errors import LimbError, ToolError
from limbcli.progress import SILENT, Progress
from limbcli.solvers import choose, is_named
from limbcli.solvers.febio_versions import version_caution
from limbcli.stages.machine import libraries
from limbcli.version import __version__

State = Literal["good", "note", "missing"]
_LEAST_PYTHON = (3, 11)
_LEAST_MEMORY_GB, _USUAL_MEMORY_GB = 2.0, 4.0  # GB, for a coarse site; for a tet10 site with 2.5 mm edges
_GB = 1e9


@dataclass(frozen=True)
class Finding:
    """The result of one check: what was found, and what to do if it is not sufficient."""

    topic: str
    name: str
    state: State
    found: str
    fix: str = ""


@dataclass(frozen=True)
class DoctorResult:
    findings: tuple[Finding, ...]

    @property
    def missing(self) -> tuple[Finding, ...]:
        return tuple(each for each in self.findings if each.state == "missing")

    @property
    def exit_code(self) -> int:
        return ToolError.exit_code if self.missing else 0

    def to_json(self) -> dict[str, Any]:
        return {"ok": not self.missing, "findings": [vars(each) for each in self.findings]}


def doctor(*, febio: Path | None = None, progress: Progress = SILENT) -> DoctorResult:
    """Check versions, packages, system libraries, solvers (with a self test), cores and memory.

    febio : the FEBio binary, if it is not found automatically; FEBio is then required to work, as it is if
        LIMBCLI_FEBIO names one

    Nothing missing raises an error: it becomes a finding with its remedy.
    """
    progress.event("stage", name="doctor")
    trials = {package: libraries.start(package) for package in libraries.TRIALS}
    findings = [*_versions(), *_packages(), *_computer()]
    progress.event("note", text="trying packages in processes of their own")
    findings += [_library(libraries.end(*each)) for each in trials.items()]
    findings += _solvers(febio, progress)
    return DoctorResult(tuple(findings))


def solver_versions() -> list[str]:
    """Name and version of each available solver; for FEBio also its path."""
    lines = [f"reference solver {__version__}"]
    try:
        solver = choose("febio")
        return [*lines, f"FEBio {solver.version()} ({solver.path()})"]  # type: ignore[attr-defined]
    except ToolError as error:
        return [*lines, f"FEBio: {error.what}"]


def _versions() -> list[Finding]:
    found = f"{platform.python_version()} ({sys.executable})"
    fine = sys.version_info[:2] >= _LEAST_PYTHON
    needed = ".".join(map(str, _LEAST_PYTHON))
    fix = "" if fine else f"install Python {needed} or newer, and limbcli in an environment of it"
    findings = [
        Finding("versions", "limbcli", "good", f"{__version__} ({Path(__file__).parents[1]})"),
        Finding("versions", "python", "good" if fine else "missing", found, fix),
    ]
    try:
        findings.append(Finding("versions", "templates", "good", str(templates_folder())))
    except ToolError as error:
        findings.append(Finding("versions", "templates", "missing", error.what, error.fix))
    return findings


def _packages() -> list[Finding]:
    """Every dependency listed in limbcli's own metadata, with its version."""
    try:
        named = metadata.requires("limbcli") or []
    except metadata.PackageNotFoundError:
        what = "limbcli is not installed as a package, so its requirements are not listed"
        return [Finding("packages", "limbcli", "note", what, "pip install limbcli (or -e of its sources)")]
    wanted = [Requirement(each) for each in named]
    return [_package(each) for each in wanted if each.marker is None or each.marker.evaluate({"extra": ""})]


def _package(wanted: Requirement) -> Finding:
    fix = f"{sys.executable} -m pip install '{wanted.name}{wanted.specifier}'"
    try:
        version = metadata.version(wanted.name)
    except metadata.PackageNotFoundError:
        return Finding("packages", wanted.name, "missing", "not installed", fix)
    if not wanted.specifier.contains(version, prereleases=True):
        return Finding("packages", wanted.name, "missing", f"{version}, needed {wanted.specifier}", fix)
    return Finding("packages", wanted.name, "good", version)


def _library(trial: libraries.LibraryTrial) -> Finding:
    purpose = libraries.PURPOSES[trial.package]
    if trial.works:
        return Finding("tried", trial.package, "good", f"{purpose}: works")
    lacking = f"; missing in the system: {', '.join(trial.missing)}" if trial.missing else ""
    usual = f"{sys.executable} -m pip install --force-reinstall {trial.package}"
    fix = libraries.remedy(trial.missing) or usual
    return Finding("tried", trial.package, "missing", f"{purpose}: {trial.why}{lacking}", fix)


def _solvers(febio: Path | None, progress: Progress) -> list[Finding]:
    found = [_tested("reference", None, progress)]
    try:
        choose("febio", febio)
    except ToolError as error:
        needed: State = "missing" if is_named(febio) else "note"
        words = "" if needed == "missing" else "; the reference solver is used instead"
        return [*found, Finding("solvers", "febio", needed, error.what + words, error.fix)]
    return [*found, _tested("febio", febio, progress)]


def _tested(kind: str, febio: Path | None, progress: Progress) -> Finding:
    """Run the self test with one solver; FEBio is optional, but must work if it is installed."""
    from limbcli.stages.machine.kernels import compile_ahead
    from limbcli.stages.machine.self_test import TOLERANCE, self_test

    try:
        if kind == "reference":
            compile_ahead()  # waited for, so that the test's time does not include compilation
        test = self_test(choose(kind, febio), progress=progress)
    except LimbError as error:
        return Finding("solvers", kind, "missing", f"the self test failed: {error.what}", error.fix)
    words = (
        f"{test.version}; a block compressed by 2 mm gives {test.force:.6g} "
        f"N, in closed form {test.expected:.6g} N ({test.seconds:.1f} s)"
    )
    caution = version_caution(test.version) if kind == "febio" else None
    if test.passed and caution:
        return Finding("solvers", kind, "note", words, caution)
    if test.passed:
        return Finding("solvers", kind, "good", words)
    fix = "install limbcli and numba again" if kind == "reference" else "install FEBio again (4.0 or newer)"
    return Finding("solvers", kind, "missing", f"{words}: more than {TOLERANCE:g} apart", fix)


def _computer() -> list[Finding]:
    findings = [Finding("computer", "cores", "good", str(cores()))]
    memory = memory_bytes()
    if memory is None:
        return [*findings, Finding("computer", "memory", "note", "not reported by the system")]
    words = f"{memory / _GB:.1f} GB"
    if memory < _USUAL_MEMORY_GB * _GB:
        fix = "use a coarser mesh (limbcli mesh --size-mm 4), or a computer with more memory"
        state: State = "missing" if memory < _LEAST_MEMORY_GB * _GB else "note"
        return [
            *findings,
            Finding("computer", "memory", state, f"{words}; usual is {_USUAL_MEMORY_GB:g}", fix),
        ]
    return [*findings, Finding("computer", "memory", "good", words)]


def memory_bytes() -> int | None:
    """Memory (bytes) that this process may use: the machine's, or a container's lower limit."""
    try:
        machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError, AttributeError):
        return None
    try:
        allowed = int(Path("/sys/fs/cgroup/memory.max").read_text())
    except (OSError, ValueError):  # no container, or "max"
        return machine
    return min(machine, allowed)
