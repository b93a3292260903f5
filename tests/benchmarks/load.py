"""Many small cases through `limbcli batch`: time, memory over time, and what is left at the end.

    python -m tests.benchmarks.load [--cases 100] [--workers 2] [--together] [--seed 7] [--folder DIR]

Every worker is one `limbcli batch` with its share of the cases (small_case.py, each with other depths), all
into one folder; with `--together` one `limbcli batch --jobs` gives work to so many processes. Resident
memory of the workers and of what they start is sampled all the time; memory "at 50 %" is the most seen
while the tenth of the cases before was worked on, the slope is of the most seen from case to case. Stray
are processes that live on and temporary files. Ends with 1 where a batch fails, a case has no report, or
anything is stray. The first samples hold the compilation of kernels, once per machine.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import linregress

from tests.benchmarks.left_behind import strays
from tests.benchmarks.small_case import COMMANDS, family, start, write_case

_SAMPLE_S, _GRACE_S = 0.5, 3.0
_SHARES = (0.1, 0.5, 1.0)


@dataclass(frozen=True)
class Sample:
    """time : s since the start; done : cases that have a report; memory : MB resident, of all processes"""

    time: float
    done: int
    memory: float


def peaks(samples: Sequence[Sample]) -> dict[int, float]:
    """Most memory (MB) while the n-th case was worked on, by n (from 1).

    >>> peaks([Sample(0, 0, 5.0), Sample(1, 0, 9.0), Sample(2, 1, 7.0)])
    {1: 9.0, 2: 7.0}
    """
    found: dict[int, float] = {}
    for each in samples:
        found[each.done + 1] = max(each.memory, found.get(each.done + 1, 0.0))
    return found


def memory_at(samples: Sequence[Sample], share: float, n_cases: int) -> float:
    """Most memory (MB) over the tenth of the cases that ends with this share of them (at least one case)."""
    last = max(1, round(share * n_cases))
    first = last - max(1, n_cases // 10)
    return max((peak for n, peak in peaks(samples).items() if first < n <= last), default=float("nan"))


def slope(samples: Sequence[Sample], n_cases: int) -> tuple[float, float]:
    """MB by which the most memory of a case grows in 100 cases, and its standard error.

    Without the first case (kernels are compiled) and the last (a worker alone); NaN where fewer than three
    are left. Of a few cases it is noise: look at the error.
    """
    kept = {n: peak for n, peak in peaks(samples).items() if 1 < n < n_cases}
    if len(kept) < 3:
        return float("nan"), float("nan")
    line = linregress(list(kept), list(kept.values()))
    return 100 * float(line.slope), 100 * float(line.stderr)


@dataclass(frozen=True)
class Load:
    """codes : exit codes of the workers; processes, files : stray at the end"""

    n_cases: int
    samples: list[Sample]
    codes: list[int]
    processes: int
    files: list[str]

    @property
    def is_sound(self) -> bool:
        whole = self.samples[-1].done == self.n_cases
        return whole and not any(self.codes) and not self.processes and not self.files

    def table(self) -> str:
        last, (growth, error) = self.samples[-1], slope(self.samples, self.n_cases)
        at = [f"{memory_at(self.samples, share, self.n_cases):.0f}" for share in _SHARES]
        heads = [
            "cases done", "s a case", *(f"MB at {share:.0%}" for share in _SHARES), "MB per 100 cases",
            "stray processes", "stray files",
        ]  # fmt: skip
        values = [
            f"{last.done} of {self.n_cases}", f"{last.time / max(last.done, 1):.1f}", *at,
            f"{growth:+.0f} (error {error:.0f})", str(self.processes), str(len(self.files)),
        ]  # fmt: skip
        return f"| {' | '.join(heads)} |\n|{'-|' * len(heads)}\n| {' | '.join(values)} |"


def reports(out: Path) -> int:
    return len(list(out.glob("*/report/report.json")))


def calls(cases: Sequence[Path], workers: int, out: Path, *, together: bool) -> list[list[str]]:
    """The words of each `limbcli batch`.

    >>> calls([Path("a"), Path("b"), Path("c")], 2, Path("out"), together=True)[0][:6]
    ['batch', 'a', 'b', 'c', '--out', 'out']
    >>> [each[1:5] for each in calls([Path("a"), Path("b")], 2, Path("out"), together=False)]
    [['a', '--out', 'out/a', '--jobs'], ['b', '--out', 'out/b', '--jobs']]
    """
    found = []
    for k in range(1 if together else workers):
        mine = [str(each) for each in (cases if together else cases[k::workers])]
        # With several cases --out holds a folder for each; with one it is that case's own.
        target = out / Path(mine[0]).name if len(mine) == 1 else out
        jobs = str(workers if together else 1)
        found.append(["batch", *mine, "--out", str(target), "--jobs", jobs, "--quiet", *COMMANDS["batch"]])
    return found


def load(n_cases: int, workers: int, seed: int, folder: Path, *, together: bool = False) -> Load:
    """Write the cases, let the workers have them, watch."""
    rng, mark, out = np.random.default_rng(seed), f"load-{os.getpid()}", folder / "out"
    cases = [
        write_case(folder / "cases" / f"S{k:03d}", subject=f"S{k:03d}", softer=float(rng.uniform(0.9, 1.1)))
        for k in range(n_cases)
    ]
    scratch = folder / "scratch"
    begun = time.perf_counter()
    running: list[subprocess.Popen[bytes]] = []
    for k, words in enumerate(calls(cases, workers, out, together=together)):
        running.append(start(words, scratch=scratch, mark=mark, log=folder / f"worker-{k}.log"))
    samples: list[Sample] = []
    while any(each.poll() is None for each in running):
        memory = sum(family(mark).values()) / 1e6
        samples.append(Sample(time.perf_counter() - begun, reports(out), memory))
        time.sleep(_SAMPLE_S)
    samples.append(Sample(time.perf_counter() - begun, reports(out), 0.0))
    end = time.monotonic() + _GRACE_S
    while (living := family(mark)) and time.monotonic() < end:
        time.sleep(_SAMPLE_S)
    for number in living:
        os.kill(number, signal.SIGKILL)
    return Load(n_cases, samples, [each.wait() for each in running], len(living), strays(out, scratch))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--together", action="store_true", help="one batch that gives work to the workers")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--folder", type=Path, help="to work in; default: one that is removed")
    options = parser.parse_args()
    if not 1 <= options.workers <= options.cases:
        parser.error(f"--workers {options.workers}: give 1 to {options.cases} (as many as there are cases)")
    with tempfile.TemporaryDirectory(prefix="load-") as scratch:
        folder = (options.folder or Path(scratch)).resolve()
        found = load(options.cases, options.workers, options.seed, folder, together=options.together)
        for k, code in enumerate(found.codes):
            if code:
                message = (folder / f"worker-{k}.log").read_text(errors="replace")
                print(f"worker {k} ended with {code}:\n{message[-2000:]}", file=sys.stderr)
    print(found.table())
    for name in found.files:
        print(f"stays: {name}", file=sys.stderr)
    sys.exit(not found.is_sound)


if __name__ == "__main__":
    main()
