"""What it costs that several processes share a batch: sites per hour, overhead of a part, memory of a worker.

    python -m tests.benchmarks.cluster [--cases 4] [--workers 1,2] [--empty 25] [--folder DIR]

For every number of workers a scheduler and so many worker processes are started on this computer. Each worker
first gets a case of its own (what it has to load is told apart), then all get the cases (small_case.py, one
site each). After that the same batch is called again: parts that find nothing to do. `--empty` cases of two
sites with stages that do nothing (tests/cli/quick_stages.py) tell what scheduler, locks and files take.
Processor seconds are those of the operating system, of a worker with all that it started; on a busy machine
only they can be trusted. Prints tables.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from distributed import Client, LocalCluster

from limbcli.progress import SILENT
from limbcli.stages.batch_cluster import together
from limbcli.stages.batching.outcome import BatchOptions
from tests.benchmarks.small_case import write_case
from tests.case.test_case_text import two_sites

OPTIONS = BatchOptions(solver="reference")
QUICK = str(Path(__file__).parents[1] / "cli" / "quick_stages.py")
_PARTS = 3  # of a case with one site
HEADS = (
    "workers", "sites", "sites an hour, wall", "sites a processor hour", "cpu s a site",
    "cpu s more for a worker's first", "cores busy", "scheduler and client, cpu ms a part",
    "nothing to do, cpu ms a part", "MB of a worker at most",
)  # fmt: skip


@dataclass(frozen=True)
class Used:
    """wall, scheduler, workers : s, the last two of processor time; peak : MB, the most of any worker"""

    wall: float
    scheduler: float
    workers: float
    peak: float

    def __sub__(self, before: Used) -> Used:
        return Used(
            self.wall - before.wall,
            self.scheduler - before.scheduler,
            self.workers - before.workers,
            self.peak,
        )


def _own() -> tuple[float, float]:
    """Processor seconds of this process and of what it started and waited for; MB it has had at most."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    seconds = own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime
    return seconds, own.ru_maxrss / 1024


def used(client: Client) -> Used:
    of_workers = client.run(_own).values()
    mine = resource.getrusage(resource.RUSAGE_SELF)
    return Used(
        time.perf_counter(), mine.ru_utime + mine.ru_stime, sum(seconds for seconds, _ in of_workers),
        max(peak for _, peak in of_workers),
    )  # fmt: skip


def run(client: Client, cases: Sequence[Path], out: Path) -> Used:
    """What this process, which is client and scheduler, and the workers take for these cases.

    Raises
    ------
    SystemExit
        If a case fails.
    """
    before = used(client)
    pairs = [(case, out / case.name) for case in cases]
    outcomes = together(
        pairs, OPTIONS, scheduler=client.scheduler.address, jobs=1, wait=True, progress=SILENT
    )
    if failed := [str(each.error) for outcome in outcomes for each in outcome.failures]:
        raise SystemExit("\n".join(failed))
    return used(client) - before


def small(folder: Path, n: int, rng: np.random.Generator) -> list[Path]:
    return [
        write_case(folder / f"S{k:03d}", subject=f"S{k:03d}", softer=float(rng.uniform(0.9, 1.1)))
        for k in range(n)
    ]


def started(n_workers: int, folder: Path, *preload: str) -> LocalCluster:
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "LIMBCLI_THREADS": "1"}
    return LocalCluster(
        n_workers=n_workers, threads_per_worker=1, processes=True, host="127.0.0.1", silence_logs=50,
        dashboard_address=None, env=threads, preload=list(preload), local_directory=str(folder),
    )  # fmt: skip


def sites(n_workers: int, n_cases: int, folder: Path) -> str:
    """A row: the cases on so many workers."""
    rng = np.random.default_rng(7)
    warm = small(folder / "warm", n_workers, rng)
    cases = small(folder / "cases", n_cases, rng)
    with started(n_workers, folder / "dask") as cluster, Client(cluster) as client:
        first = run(client, warm, folder / "out-warm")
        found = run(client, cases, folder / "out")
        again = run(client, cases, folder / "out")
    each = found.workers / n_cases
    values = [
        f"{n_workers}", f"{n_cases}", f"{3600 * n_cases / found.wall:.0f}", f"{3600 / each:.0f}",
        f"{each:.1f}", f"{first.workers / n_workers - each:.1f}", f"{found.workers / found.wall:.2f}",
        f"{1000 * found.scheduler / (_PARTS * n_cases):.0f}",
        f"{1000 * again.workers / (_PARTS * n_cases):.0f}", f"{found.peak:.0f}",
    ]  # fmt: skip
    return f"| {' | '.join(values)} |"


def empty(n_cases: int, folder: Path) -> str:
    """A row: parts that do nothing, on two workers."""
    cases = [two_sites(folder / f"E{k:03d}") for k in range(n_cases + 2)]
    with started(2, folder / "dask", QUICK) as cluster, Client(cluster) as client:
        run(client, cases[:2], folder / "out-warm")
        found = run(client, cases[2:], folder / "out")
    n = 4 * n_cases
    values = [f"{n}", *(f"{1000 * each / n:.1f}" for each in (found.wall, found.scheduler, found.workers))]
    return f"| {' | '.join(values)} |"


def stored(folder: Path) -> tuple[int, float]:
    """(files, MB) below a folder."""
    sizes = [each.stat().st_size for each in folder.rglob("*") if each.is_file()]
    return len(sizes), sum(sizes) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=4)
    parser.add_argument("--workers", default="1,2")
    parser.add_argument("--empty", type=int, default=25, help="cases whose stages do nothing; 0: none")
    parser.add_argument("--folder", type=Path, help="to work in; default: one that is removed")
    options = parser.parse_args()
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with tempfile.TemporaryDirectory(prefix="cluster-") as scratch:
        folder = (options.folder or Path(scratch)).resolve()
        if options.empty:
            print(
                "| parts that do nothing | ms a part, wall | scheduler and client, cpu ms | worker, cpu ms |"
            )
            print("|-|-|-|-|")
            print(empty(options.empty, folder / "empty"), flush=True)
        if options.cases:
            print(f"| {' | '.join(HEADS)} |\n|{'-|' * len(HEADS)}")
            for n_workers in map(int, options.workers.split(",")):
                print(sites(n_workers, options.cases, folder / f"{n_workers}"), flush=True)
            files, size = stored(folder / options.workers.split(",")[0] / "out" / "S000")
            print(f"\na site leaves {files} files, {size:.1f} MB")


if __name__ == "__main__":
    main()
