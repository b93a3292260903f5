"""Processor time and peak memory of the commands: of another commit and of this tree, in turns.

    python -m tests.benchmarks.against COMMIT [--rows help,segment] [--repeats 3]

COMMIT is checked out to a temporary folder and uses the libraries of this environment. Each command of the
demo runs `--repeats` times with its kernels compiled, every time on the same results of the commands before
it; the median counts. "first use" is the same with no kernel compiled, once, less that. One thread. What
costs over 5 % more is marked, and the exit code is 1. --rows: these, and what they need. "peak memory": of
all commands run.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
MARKED = 1.05  # ratio of processor time above which a row is marked
_SUBJECT, _OUT = ("subject",), ("subject", "--out", "results")
COMMANDS = {
    "help": ("--help",),
    "new": ("new", "made"),
    "phantom": ("phantom", *_SUBJECT, "--seed", "7", "--max-force-n", "10", "--force"),
    "check": ("check", *_SUBJECT),
    "segment": ("segment", *_OUT),
    "mesh": ("mesh", *_OUT, "--size-mm", "4", "--far-size-mm", "12"),
    "build-feb": ("build-feb", *_OUT),
    "run": ("run", *_OUT, "--solver", "reference"),
    "fit": ("fit", *_OUT, "--solver", "reference"),
    "diagnose": ("diagnose", *_OUT),
    "report": ("report", *_OUT),
}
FIRST_USE = ("run", "fit", "diagnose")
_CALF = "calf"  # a row only where the reference data are
_NEEDED = ("phantom", "segment", "mesh", "build-feb", "run", "fit")  # each needs those before it
_CASE = 'format = 1\n[subject]\nid = "calf"\nlimb = "right"\n[imaging]\nmri = "mri"\n'


@dataclass
class Tree:
    """The sources of a commit, and a folder for what its commands write."""

    sources: Path
    folder: Path
    peak_mb: float = 0.0
    seconds: dict[str, list[float]] = field(default_factory=dict)

    def run(self, row: str, words: tuple[str, ...], *, kernels: str = "kernels") -> None:
        """Run a command and note its processor time, that of its child processes included."""
        shutil.rmtree(self.folder / "made", ignore_errors=True)
        shutil.rmtree(self.folder / "results", ignore_errors=True)
        if (self.folder / "given").is_dir():
            shutil.copytree(self.folder / "given", self.folder / "results")
        environment = {
            **os.environ, "PYTHONPATH": str(self.sources), "NUMBA_CACHE_DIR": str(self.folder / kernels),
            "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
            "LIMBCLI_THREADS": "1",
        }  # fmt: skip
        log = self.folder / f"{row}.log"
        with log.open("wb") as stream:
            started = subprocess.Popen(
                [sys.executable, "-m", "limbcli", *words], cwd=self.folder, env=environment,
                stdout=stream, stderr=subprocess.STDOUT,
            )  # fmt: skip
            _, status, used = os.wait4(started.pid, 0)
            started.returncode = os.waitstatus_to_exitcode(status)
        if started.returncode:
            raise SystemExit(f"{row} of {self.sources} failed:\n{log.read_text(errors='replace')[-2000:]}")
        self.peak_mb = max(self.peak_mb, used.ru_maxrss / 1024)
        self.seconds.setdefault(row, []).append(used.ru_utime + used.ru_stime)

    def keep(self) -> None:
        """Give the results as they are to every later run."""
        shutil.rmtree(self.folder / "given", ignore_errors=True)
        if (self.folder / "results").is_dir():
            shutil.move(self.folder / "results", self.folder / "given")

    def median(self, row: str) -> float:
        """Processor seconds of a row; a first use without the time that the command takes later."""
        if row in self.seconds:
            return statistics.median(self.seconds[row])
        command = row.removeprefix("first use: ")
        return max(self.median(f"{command}, cold") - self.median(command), 0.0)


@contextmanager
def checked_out(commit: str, folder: Path) -> Iterator[Path]:
    """A work tree of the commit."""
    where = folder / "sources"
    subprocess.run(["git", "-C", ROOT, "worktree", "add", "--detach", "--quiet", where, commit], check=True)
    try:
        yield where
    finally:
        subprocess.run(["git", "-C", ROOT, "worktree", "remove", "--force", where], check=False)


def measure(trees: tuple[Tree, Tree], rows: list[str], calf: Path | None, repeats: int) -> list[str]:
    """Run what the rows need, in turns; returns the rows of the table."""
    asked = [each for each in COMMANDS if each in rows]
    deepest = max((_NEEDED.index(each) for each in asked if each in _NEEDED), default=-1)
    deepest = max([deepest, *(0 for each in asked if each == "check")])
    needs_all = {"diagnose", "report"} & {*asked}
    wanted = {*asked, *(_NEEDED if needs_all else _NEEDED[: deepest + 1])}
    table: list[str] = []
    for row, words in COMMANDS.items():
        if row not in wanted:
            continue
        if row in FIRST_USE and row in asked:
            for tree in trees:
                tree.run(f"{row}, cold", words, kernels=f"kernels-{row}")
            table.append(f"first use: {row}")
        for tree in trees:
            tree.run(f"{row}, not counted", words)  # compiles what is not compiled yet
        for turn in range(repeats if row in asked else 0):
            for tree in trees if turn % 2 else trees[::-1]:
                tree.run(row, words)
        table += [row] if row in asked else []
        for tree in trees:
            tree.keep()
    if calf is not None and _CALF in rows:
        for tree in trees:
            (tree.folder / _CALF).mkdir()
            (tree.folder / _CALF / "case.toml").write_text(_CASE)
            shutil.copytree(calf, tree.folder / _CALF / "mri")
        for turn in range(repeats):
            for tree in trees if turn % 2 else trees[::-1]:
                tree.run(_CALF, ("segment", _CALF, "--out", "of-calf", "--fresh"))
        table.append(_CALF)
    return table


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("commit")
    parser.add_argument("--rows", default=",".join([*COMMANDS, _CALF]))
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    rows = options.rows.split(",")
    if unknown := {*rows} - {*COMMANDS, _CALF}:
        parser.error(f"--rows: no {', '.join(sorted(unknown))}; there are {', '.join([*COMMANDS, _CALF])}")
    data = Path(os.environ.get("LIMBCLI_SHARED") or ROOT.parent / "shared") / "data" / "calf-mri"
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, checked_out(options.commit, Path(folder)) as sources:
        trees = Tree(sources, Path(folder) / "before"), Tree(ROOT, Path(folder) / "now")
        for tree in trees:
            tree.folder.mkdir()
        table = measure(trees, rows, data if data.is_dir() else None, max(options.repeats, 1))
        figures = [(row, trees[0].median(row), trees[1].median(row), "s") for row in table]
        figures.append(("peak memory", trees[0].peak_mb, trees[1].peak_mb, "MB"))
    print(f"| what | {options.commit} | now | ratio | |\n|-|-|-|-|-|")
    dearer = 0
    for row, before, now, unit in figures:
        ratio = now / before if before else 1.0
        dearer += ratio > MARKED
        shown = (
            f"{before:.2f} {unit} | {now:.2f} {unit}"
            if unit == "s"
            else f"{before:.0f} {unit} | {now:.0f} {unit}"
        )
        print(f"| {row} | {shown} | {ratio:.2f} | {'costs more' if ratio > MARKED else ''} |")
    print(f"\n{time.monotonic() - begun:.0f} s in all", file=sys.stderr)
    return 1 if dearer else 0


if __name__ == "__main__":
    sys.exit(main())
