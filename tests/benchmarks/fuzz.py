"""Damaged and hostile files: how every reader answers, as a table.

    python -m tests.benchmarks.fuzz [--n 20000] [--seed 7] [--only NAME] [--keep FOLDER] [--memory-gb 4]

Every input is a good file damaged by its seed (tests/fuzz/mutations.py); each kind is read in a process of
its own with so much memory. Good answers are "refused" (an error with a way out) and "read" (nothing
impossible in what was read); a traceback, a hang over 30 s, too much memory or a killed process is a fault.
"""

from __future__ import annotations

import argparse
import collections
import json
import resource
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from tests.fuzz.targets import TARGETS, Target
from tests.fuzz.trial import GOOD, LIMIT_S, try_one


def work(target: Target, numbers: range, seed: int, keep: Path | None, memory: int) -> None:
    """Read inputs by number, one line of JSON each; the last line printed tells where a death happened."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    target.make(folder)
    good = (folder / target.file).read_bytes()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    resource.setrlimit(resource.RLIMIT_AS, (memory + (8 << 30), memory + (8 << 30)))
    for number in numbers:
        print(json.dumps({"number": number}), flush=True)
        trial = try_one(target, folder, good, (seed, TARGETS.index(target), number))
        now = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        outcome = "memory" if (now - before) * 1024 > memory else trial.outcome
        before = max(now, before) if outcome == "memory" else before
        if outcome not in GOOD and keep is not None:
            name = f"{TARGETS.index(target):02d}-{number}-{target.file}"
            (keep / name).write_bytes((folder / target.file).read_bytes())
        print(json.dumps({"number": number, "outcome": outcome, "detail": trial.detail[:300]}), flush=True)


def run(target: Target, n: int, options: argparse.Namespace) -> list[dict[str, object]]:
    """All inputs of one kind; a process that dies or hangs is followed by another."""
    found: list[dict[str, object]] = []
    start = 0
    while start < n:
        command = [
            sys.executable, "-m", "tests.benchmarks.fuzz", "--worker", target.name, "--start", str(start),
            "--n", str(n), "--seed", str(options.seed), "--memory-gb", str(options.memory_gb),
        ] + (["--keep", str(options.keep)] if options.keep else [])  # fmt: skip
        try:
            lines = subprocess.run(
                command, capture_output=True, text=True, timeout=n * 0.5 + 10 * LIMIT_S
            ).stdout.splitlines()
            death = "killed"
        except subprocess.TimeoutExpired as error:
            lines = (error.stdout or b"").decode().splitlines()
            death = "hang"
        rows = [json.loads(line) for line in lines if line.startswith("{") and line.endswith("}")]
        ended = [row for row in rows if "outcome" in row]
        found += ended
        last = rows[-1]["number"] if rows else start
        if len(ended) < n - start:
            found.append({"number": last, "outcome": death, "detail": "the process ended"})
        start = last + 1
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=20_000, help="inputs in all")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--only", help="kinds whose name holds this")
    parser.add_argument("--keep", type=Path, help="a folder for the files of faults")
    parser.add_argument("--memory-gb", type=float, default=4.0)
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--start", type=int, default=0, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    if options.worker:
        target = next(each for each in TARGETS if each.name == options.worker)
        numbers = range(options.start, options.n)
        work(target, numbers, options.seed, options.keep, int(options.memory_gb * (1 << 30)))
        return
    chosen = [each for each in TARGETS if not options.only or options.only in each.name]
    each_n = -(-options.n // len(chosen))
    faults = []
    print("| input | tried | refused | read | faults |\n|---|---|---|---|---|")
    for target in chosen:
        if target.needs and find_spec(target.needs) is None:
            print(f"| {target.name} | 0: {target.needs} is not installed | | | |", flush=True)
            continue
        rows = run(target, each_n, options)
        counts = collections.Counter(str(row["outcome"]) for row in rows)
        bad = [row for row in rows if row["outcome"] not in GOOD]
        words = ", ".join(f"{n} {name}" for name, n in counts.items() if name not in GOOD) or "0"
        print(
            f"| {target.name} | {len(rows)} | {counts['refused']} | {counts['read']} | {words} |", flush=True
        )
        faults += [(target.name, row) for row in bad]
    kinds = collections.Counter((name, row["outcome"], str(row["detail"])[:160]) for name, row in faults)
    for (name, outcome, detail), count in kinds.most_common(60):
        print(f"{count:5d} {name}: {outcome}: {detail}")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
