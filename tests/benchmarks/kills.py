"""kill -9 at any moment of every command: does the same command, called again, put all right?

    python -m tests.benchmarks.kills [--kills 50] [--commands segment,mesh,...] [--seed 7] [--folder DIR]

Every command works on a small case (small_case.py) from the results of those before it. It is run twice
undisturbed: that gives its duration, the span in which a child process works for it, and what differs by
itself. Then it is killed at random moments: of the whole duration, and, of every three kills of a command
that has a child, once while a child works and once the child instead of the command. After each kill the
same command is run again. Faults: results that are not those of an undisturbed run, a file at its place
that was not whole after the kill, processes that live on, files that stay. Ends with 1 where there are any.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.benchmarks.left_behind import Content, contents, differing, halves, strays
from tests.benchmarks.small_case import COMMANDS, family, start, write_case

_POLL_S, _GRACE_S, _LIMIT_S = 0.02, 3.0, 900.0
_LEAST_S = 0.05  # a kill is not earlier: the command is hardly a process before
_AT_WORK = 0.8  # of a child's usual time: it is still there then, on a machine that is not idle
COMMAND, BESIDE, CHILD = "command", "command beside its child", "child"


@dataclass(frozen=True)
class Undisturbed:
    """took : s; child : s that its children were at work, or None where it has none

    left : what it left, by path; itself : paths that differ between two undisturbed runs
    """

    took: float
    child: float | None
    left: Content
    itself: frozenset[str]


@dataclass(frozen=True)
class Kill:
    """share : moment, as a share of the undisturbed duration, or of the child's after it began

    target : COMMAND at any moment, BESIDE: the command while a child works, CHILD: the child alone
    """

    share: float
    target: str = COMMAND


@dataclass
class Row:
    """What the kills of one command came to; `faults` in words."""

    command: str
    took: float
    itself: frozenset[str]
    kills: list[Kill] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    n_equal: int = 0

    def line(self) -> str:
        shares = sorted(round(100 * each.share) for each in self.kills if each.target == COMMAND)
        moments = ", ".join(map(str, shares))
        for target in (BESIDE, CHILD):
            if n := sum(each.target == target for each in self.kills):
                moments += f"; {n} x {target}"
        what = "; ".join(dict.fromkeys(self.faults)) or "nothing"
        equal = f"{self.n_equal} of {len(self.kills)}"
        return f"| {self.command} | {self.took:.1f} | {len(self.kills)} | {moments} | {equal} | {what} |"


def plan(n: int, ran: Undisturbed, rng: np.random.Generator) -> list[Kill]:
    """n kills: those at any moment fall one into every equal part of the duration, so that all is covered.

    With a child, of every three one is beside the child and one is the child's own.
    """
    targets = [COMMAND] * n if ran.child is None else [(COMMAND, BESIDE, CHILD)[k % 3] for k in range(n)]
    anywhere = targets.count(COMMAND)
    shares = iter((np.arange(anywhere) + rng.uniform(size=anywhere)) / max(anywhere, 1))
    return [
        Kill(float(next(shares) if target == COMMAND else rng.uniform(0, _AT_WORK)), target)
        for target in targets
    ]


class Bench:
    """One case, the place where commands write, and the state each command begins from."""

    def __init__(self, folder: Path, mark: str):
        self.folder, self.mark = folder, mark
        self.case = write_case(folder / "case")
        self.out, self.scratch, self.log = folder / "out", folder / "scratch", folder / "said.log"

    def begin(self, command: str) -> subprocess.Popen[bytes]:
        words = [command, str(self.case), "--out", str(self.out), "--quiet", *COMMANDS[command]]
        self.log.unlink(missing_ok=True)
        return start(words, scratch=self.scratch, mark=self.mark, log=self.log)

    def restore(self, before: Path) -> None:
        """The output folder as it was; nothing in the scratch folder."""
        for folder in (self.out, self.scratch):
            shutil.rmtree(folder, ignore_errors=True)
        if before.exists():
            shutil.copytree(before, self.out)

    def whole(self, command: str) -> tuple[float, float | None]:
        """An undisturbed run: seconds, and those in which it had a child.

        Raises
        ------
        SystemExit
            If it fails, with what it said.
        """
        begun = time.perf_counter()
        process = self.begin(command)
        with_child, last = 0.0, begun
        while process.poll() is None:
            now = time.perf_counter()
            if now - begun > _LIMIT_S:
                process.kill()
            if self.child_of(process) is not None:
                with_child += now - last
            last = now
            time.sleep(_POLL_S)
        took = time.perf_counter() - begun
        if process.returncode:
            sys.exit(f"limbcli {command} ended with {process.returncode}:\n{self.log.read_text()[-2000:]}")
        return took, with_child or None

    def child_of(self, process: subprocess.Popen[bytes]) -> int | None:
        """A process that works for the command, by its id."""
        return next((number for number in family(self.mark) if number != process.pid), None)

    def undisturbed(self, command: str, before: Path) -> Undisturbed:
        """Two runs; the second has compiled kernels and tells the time."""
        found = []
        for _ in range(2):
            self.restore(before)
            took, child = self.whole(command)
            found.append(contents(self.out))
        return Undisturbed(took, child, found[1], frozenset(differing(*found)))

    def killed(self, command: str, kill: Kill, ran: Undisturbed) -> list[str]:
        """Kill it at that moment, if it has not ended; faults: what lives on."""
        process = self.begin(command)
        moment = time.perf_counter() + max(kill.share * ran.took, _LEAST_S)
        victim: int | None = process.pid
        if kill.target != COMMAND:
            while (child := self.child_of(process)) is None and process.poll() is None:
                time.sleep(_POLL_S / 4)
            moment = time.perf_counter() + kill.share * (ran.child or 0.0)
            victim = child if kill.target == CHILD else process.pid
        while time.perf_counter() < moment and process.poll() is None:
            time.sleep(min(_POLL_S, max(0.0, moment - time.perf_counter())))
        if victim in family(self.mark):
            os.kill(victim, signal.SIGKILL)
        process.wait(timeout=_LIMIT_S)
        end = time.monotonic() + _GRACE_S
        while (living := family(self.mark)) and time.monotonic() < end:
            time.sleep(_POLL_S)
        for number in living:
            os.kill(number, signal.SIGKILL)
        return [f"{len(living)} processes live on"] if living else []

    def trial(self, command: str, kill: Kill, before: Path, ran: Undisturbed) -> list[str]:
        """Kill, call again, compare; faults in words."""
        self.restore(before)
        start_state = contents(self.out)
        faults = self.killed(command, kill, ran)
        faults += [
            f"at its place, but not of a whole run: {name}"
            for name in halves(self.out, start_state, ran.left, ran.itself)
        ]
        again = self.begin(command).wait(timeout=_LIMIT_S)
        if again:
            last = self.log.read_text().strip().splitlines()[-3:]
            return [*faults, f"called again it ended with {again}: {' '.join(last)[:200]}"]
        unlike = [each for each in differing(contents(self.out), ran.left) if each not in ran.itself]
        faults += [f"differs: {name}" for name in unlike]
        return faults + [f"stays: {name}" for name in strays(self.out, self.scratch)]


def bench(commands: Sequence[str], kills: int, seed: int, folder: Path) -> list[Row]:
    """All commands in order; each leaves its undisturbed result to those after it."""
    rng = np.random.default_rng(seed)
    place = Bench(folder, f"kills-{os.getpid()}")
    share, more = divmod(kills, len(commands))
    rows: list[Row] = []
    for command in COMMANDS:
        before = folder / f"before-{command}"
        if command == "batch":  # from nothing
            shutil.rmtree(place.out, ignore_errors=True)
        if place.out.exists():
            shutil.copytree(place.out, before)
        if command not in commands:
            if command != "batch":
                place.whole(command)
            continue
        ran = place.undisturbed(command, before)
        after = folder / f"after-{command}"
        shutil.copytree(place.out, after)
        row = Row(command, ran.took, ran.itself)
        for kill in plan(share + (len(rows) < more), ran, rng):
            faults = place.trial(command, kill, before, ran)
            row.kills.append(kill)
            row.n_equal += not any(each.startswith(("differs", "called")) for each in faults)
            row.faults += faults
            for fault in faults:
                print(
                    f"{command}, {kill.target} killed at {kill.share:.0%}: {fault}",
                    file=sys.stderr,
                    flush=True,
                )
        rows.append(row)
        print(row.line(), flush=True)
        place.restore(after)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50, help="in all")
    parser.add_argument("--commands", default=",".join(COMMANDS))
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--folder", type=Path, help="to work in; default: one that is removed")
    options = parser.parse_args()
    commands = options.commands.split(",")
    if unknown := set(commands) - set(COMMANDS):
        parser.error(f"--commands: no {', '.join(sorted(unknown))}; there are {', '.join(COMMANDS)}")
    print(
        "| command | s undisturbed | kills | moments, % | equal afterwards | faults |\n|-|-|-|-|-|-|",
        flush=True,
    )
    with tempfile.TemporaryDirectory(prefix="kills-") as scratch:
        rows = bench(commands, options.kills, options.seed, (options.folder or Path(scratch)).resolve())
    for row in rows:
        if row.itself:
            names = ", ".join(sorted(row.itself))
            print(f"{row.command}: differ between undisturbed runs, not compared: {names}")
    faults = sum(len(row.faults) for row in rows)
    print(f"{sum(len(row.kills) for row in rows)} kills, {faults} faults")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
