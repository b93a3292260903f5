"""Both ends of the ranges in pyproject.toml, each in a fresh environment, as a table.

    python tests/benchmarks/dependencies.py [--ends oldest,newest] [--tests none|smoke|quick] [--folder DIR]
    python tests/benchmarks/dependencies.py --licences
    python tests/benchmarks/dependencies.py --ends newest --tests none --audit

oldest: every lower bound, exactly; where it has no wheel for this Python, the next version that has one,
marked `*`. newest: what the package index gives today. Only wheels are installed. `--licences` is about
the environment that runs this: run-time dependencies and theirs. `--audit` asks pip-audit for known
vulnerabilities of each end. Ends with 1 where an end fails; a database out of reach is said, and no failure.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
import venv
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

REPOSITORY = Path(__file__).resolve().parents[2]
ENDS = ("oldest", "newest")
FOR_TESTS = ("pytest", "hypothesis", "pytest-xdist", "lxml-stubs")
SMOKE = (
    "tests/cli/test_app.py", "tests/test_case.py", "tests/test_files.py", "tests/materials/test_laws.py",
    "tests/imaging/test_dicom.py", "tests/imaging/test_labels.py", "tests/imaging/test_surface.py",
    "tests/meshing/test_volume.py", "tests/meshing/test_surfaces.py", "tests/fem/test_element.py",
    "tests/feb/test_read_feb.py", "tests/reporting/test_figures.py", "tests/stages/test_mesh.py",
)  # fmt: skip
_NO_WHEEL = re.compile(r"requirement (\S+?)==(\S+) \(from versions: ([^)]*)\)")
_COUNTS = re.compile(r"(\d+) (passed|failed|error|errors|skipped)")
_UNREACHABLE = (
    "ConnectionError",
    "Max retries",
    "Name or service",
    "timed out",
    "ServiceError",
)


def requirements() -> list[Requirement]:
    """Run-time dependencies of pyproject.toml that hold on this system."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = [Requirement(text) for text in project["dependencies"]]
    return [each for each in found if each.marker is None or each.marker.evaluate()]


def lower_bound(requirement: Requirement) -> str:
    """
    >>> lower_bound(Requirement("numpy>=1.26,<3"))
    '1.26'
    """
    bounds = [each.version for each in requirement.specifier if each.operator in (">=", "==", "~=")]
    if not bounds:
        raise ValueError(f"{requirement} in pyproject.toml has no lower bound; give it one (>=)")
    return max(bounds, key=Version)


def next_version(wanted: str, offered: str) -> str | None:
    """The lowest release above `wanted` of pip's list of versions that have a wheel; None if there is none.

    >>> next_version("1.2", "1.0, 1.3rc1, 1.10, 1.3")
    '1.3'
    """
    releases = []
    for text in offered.split(","):
        try:
            version = Version(text.strip())
        except InvalidVersion:
            continue
        if version > Version(wanted) and not version.is_prerelease:
            releases.append(version)
    return str(min(releases)) if releases else None


def why_not(answer: str) -> str:
    """What pip says of an installation that failed: who wants what, else its errors.

    >>> why_not("The conflict is caused by:\\n    a 1 depends on b>=2\\n\\nERROR: ResolutionImpossible")
    'conflict: a 1 depends on b>=2'
    """
    _, found, after = answer.partition("The conflict is caused by:")
    if found:
        return "conflict: " + "; ".join(line.strip() for line in after.strip().split("\n\n")[0].splitlines())
    return "; ".join(line for line in answer.splitlines() if "ERROR" in line)[:400] or answer[-400:]


@dataclass
class End:
    """One environment and what came of it.

    pins : version asked for by package, empty: the newest; moved : packages without a wheel of their bound
    """

    name: str
    python: Path
    pins: dict[str, str] = field(default_factory=dict)
    moved: set[str] = field(default_factory=set)
    versions: dict[str, str] = field(default_factory=dict)
    outcomes: dict[str, str] = field(default_factory=dict)
    failed: bool = False

    def run(self, *command: object, limit_s: float = 1800) -> subprocess.CompletedProcess[str]:
        """In the repository, with nothing of the environment that runs this."""
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
        environment |= {"NUMBA_CACHE_DIR": str(self.python.parents[1] / "kernels")}
        return subprocess.run(
            [str(self.python), *map(str, command)], cwd=REPOSITORY, env=environment, text=True,
            capture_output=True, timeout=limit_s,
        )  # fmt: skip

    def note(self, what: str, outcome: str, *, failed: bool = False) -> None:
        self.outcomes[what], self.failed = outcome, self.failed or failed
        print(f"{self.name}: {what}: {outcome}", file=sys.stderr, flush=True)

    def install(self) -> bool:
        """limbcli and its dependencies at this end; a bound without a wheel moves up."""
        pip = ("-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off")
        while True:
            wanted = [f"{name}=={version}" for name, version in self.pins.items()] or ["--upgrade"]
            done = self.run(*pip, "--only-binary", ":all:", *wanted, REPOSITORY, *FOR_TESTS)
            if done.returncode == 0:
                self.note("install", "ok")
                return True
            missing = _NO_WHEEL.search(done.stderr)
            name = canonicalize_name(missing[1]) if missing else ""
            higher = next_version(missing[2], missing[3]) if missing and name in self.pins else None
            if higher is None:
                self.note("install", why_not(done.stdout + done.stderr), failed=True)
                return False
            self.pins[name] = higher
            self.moved.add(name)

    def look(self) -> None:
        """Versions that were installed, and whether the command answers, also with a page of help."""
        done = self.run("-m", "pip", "list", "--format", "freeze", "--disable-pip-version-check")
        pairs = (line.split("==") for line in done.stdout.splitlines() if line.count("==") == 1)
        self.versions = {canonicalize_name(name): version for name, version in pairs}
        for words in (("--version",), ("fit", "--help")):
            done = self.run("-P", self.python.parent / "limbcli", *words, limit_s=60)
            answer = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines() or [
                "nothing"
            ]
            self.note(" ".join(("limbcli", *words)), answer[0].strip()[:200], failed=done.returncode != 0)

    def test(self, which: str) -> None:
        chosen = SMOKE if which == "smoke" else ()
        command = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", "--tb=line",
                   "--continue-on-collection-errors", *chosen)  # fmt: skip
        begun = time.perf_counter()
        try:
            done = self.run(*command)
        except subprocess.TimeoutExpired:
            self.note(f"{which} tests", "stopped after 1800 s", failed=True)
            return
        lines = done.stdout.splitlines() or [done.stderr[-300:]]
        for line in lines:
            if line.startswith(("FAILED", "ERROR")):
                print(f"{self.name}: {line[:300]}", file=sys.stderr)
        counts = ", ".join(" ".join(each) for each in _COUNTS.findall(lines[-1])) or lines[-1][:200]
        if done.returncode < 0:  # a library crashed: the first lines of its trace are Python's
            where = [line.strip() for line in done.stderr.splitlines() if line.startswith("  File")][:1]
            counts = f"killed by signal {-done.returncode}, {' '.join(where) or 'nowhere'}"
        self.note(
            f"{which} tests", f"{counts} ({time.perf_counter() - begun:.0f} s)", failed=bool(done.returncode)
        )

    def audit(self) -> None:
        """Known vulnerabilities, by a pip-audit that has an environment of its own."""
        home = self.python.parents[1].with_name("audit")
        tool = End("audit", home / "bin" / "python")
        if not tool.python.exists():
            venv.create(home, with_pip=True)
        done = tool.run("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "pip-audit")
        if done.returncode:
            self.note("audit", "pip-audit cannot be had here")
            return
        packages = next((self.python.parents[1] / "lib").glob("python*/site-packages"))
        done = tool.run("-m", "pip_audit", "--path", packages, "--progress-spinner", "off", limit_s=300)
        self.note("audit", audit_outcome(done.returncode, done.stdout, done.stderr))


def audit_outcome(status: int, printed: str, complaints: str) -> str:
    """What pip-audit found, in words.

    >>> audit_outcome(1, "", "requests.exceptions.ConnectionError: Max retries exceeded")
    'the database cannot be reached from here'
    >>> audit_outcome(0, "pillow Dependency not found on PyPI and could not be audited: pillow (10.0.0)", "")
    'unknown: the database reached from here does not answer for 1 packages'
    """
    if status and any(word in complaints for word in _UNREACHABLE):
        return "the database cannot be reached from here"
    if skipped := len(re.findall("could not be audited", printed + complaints)):
        return f"unknown: the database reached from here does not answer for {skipped} packages"
    found = [
        line.split()[:3] for line in printed.splitlines() if re.match(r"\S+\s+\S+\s+(CVE|GHSA|PYSEC)-", line)
    ]
    if found:
        return ", ".join(" ".join(each) for each in found)
    return "nothing known" if status == 0 else f"pip-audit failed: {complaints.strip()[-200:]}"


def licence_of(package: metadata.PackageMetadata) -> str:
    """As the package's metadata say it: an expression, else the classifiers, else the first line of text."""
    if expression := package.get("License-Expression"):
        return expression
    classifiers = [each for each in package.get_all("Classifier") or [] if each.startswith("License ::")]
    names = [each.split(" :: ")[-1] for each in classifiers if each.split(" :: ")[-1] != "OSI Approved"]
    text = (package.get("License") or "").strip().splitlines()
    return ", ".join(names) or (text[0].strip() if text else "not said")


def licences(wanted: list[Requirement]) -> list[tuple[str, str, str]]:
    """Package, version and licence of the requirements and of all that they require, by name."""
    rows: dict[str, tuple[str, str, str]] = {}
    todo = [(each, frozenset(each.extras)) for each in wanted]
    seen: set[tuple[str, frozenset[str]]] = set()
    while todo:
        requirement, extras = todo.pop()
        name = canonicalize_name(requirement.name)
        if (name, extras) in seen:
            continue
        seen.add((name, extras))
        try:
            package = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            rows[name] = (name, "not installed", "")
            continue
        rows[name] = (name, package.version, licence_of(package.metadata))
        for text in package.requires or []:
            needed = Requirement(text)
            marker = needed.marker
            if marker is None or any(marker.evaluate({"extra": each}) for each in ("", *extras)):
                todo.append((needed, frozenset(needed.extras)))
    return [rows[name] for name in sorted(rows)]


def table(ends: list[End], wanted: list[Requirement]) -> list[str]:
    """Bounds and versions by package, then what was tried."""
    head = ["package", "range", *(end.name for end in ends)]
    rows = [head, ["-"] * len(head)]
    for each in wanted:
        name = canonicalize_name(each.name)
        got = [end.versions.get(name, "not installed") + "*" * (name in end.moved) for end in ends]
        rows.append([name, str(each.specifier), *got])
    for what in dict.fromkeys(key for end in ends for key in end.outcomes):
        rows.append([what, "", *(end.outcomes.get(what, "not tried") for end in ends)])
    return [f"| {' | '.join(row)} |" for row in rows]


def tried(name: str, folder: Path, options: argparse.Namespace) -> End:
    """One end, from nothing."""
    pins = {canonicalize_name(each.name): lower_bound(each) for each in requirements()}
    end = End(name, folder / name / "bin" / "python", pins if name == "oldest" else {})
    venv.create(folder / name, with_pip=True, clear=True)
    if end.install():
        end.look()
        if options.tests != "none":
            end.test(options.tests)
        if options.audit:
            end.audit()
    return end


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ends", default="oldest,newest")
    parser.add_argument("--tests", choices=("none", "smoke", "quick"), default="quick")
    parser.add_argument("--folder", type=Path, help="for the environments; default: one that is removed")
    parser.add_argument("--licences", action="store_true")
    parser.add_argument("--audit", action="store_true")
    options = parser.parse_args()
    wanted = requirements()
    if options.licences:
        print("| package | version | licence |\n|-|-|-|")
        print("\n".join(f"| {' | '.join(row)} |" for row in licences(wanted)))
        return
    names = options.ends.split(",")
    if unknown := set(names) - set(ENDS):
        parser.error(f"--ends: there is no end {', '.join(unknown)}; there are {', '.join(ENDS)}")
    with tempfile.TemporaryDirectory(prefix="dependencies-") as scratch:
        ends = [tried(name, (options.folder or Path(scratch)).resolve(), options) for name in names]
        print("\n".join(table(ends, wanted)))
    sys.exit(any(end.failed for end in ends))


if __name__ == "__main__":
    main()
