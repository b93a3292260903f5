"""The processes that run the parts of a batch: local processes, or a cluster given by its address.

Dask distributed starts the processes, distributes the work, reassigns the work of a lost process and
provides a dashboard. This module only enforces limbcli's requirements on workers: the same code as the
caller's, and one part at a time in each process.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import platform
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from limbcli.config import THREADS
from limbcli.errors import ToolError
from limbcli.files.temporary_folders import scratch_folder
from limbcli.progress import Progress
from limbcli.provenance.batch_memory import code_hash
from limbcli.version import __version__

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

EXTRA = "cluster"
_GB_A_WORKER = 2.0  # GB of memory for each worker: what `segment` needs for a large series
_WAIT_S = 30  # s, time limit for a scheduler to answer
# Dask settings for local processes: parts queue at the scheduler, not at a worker that may be lost; if no
# worker is left, parts fail after the timeout.
_LOCAL = {
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.no-workers-timeout": "5 minutes",
    "distributed.comm.timeouts.connect": "2 minutes",
}
_LIBRARY_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class WorkerRefused(ToolError):
    """The worker does not meet the client's requirements; its address is among the facts."""


@dataclass(frozen=True)
class WorkerStanding:
    """A worker's limbcli version, the hash of its sources, and the number of parts it runs at a time."""

    version: str
    code: str
    n_threads: int

    @staticmethod
    def own(n_threads: int = 1) -> WorkerStanding:
        return WorkerStanding(__version__, code_hash(), n_threads)

    def why_not(self, client: WorkerStanding) -> str:
        """Why this client may not use the worker; empty if it may.

        >>> ours = WorkerStanding("1.0", "abcdef0123", 1)
        >>> WorkerStanding("1.0", "abcdef0123", 1).why_not(ours)
        ''
        >>> WorkerStanding("1.0", "9876543210", 1).why_not(ours)
        'it has limbcli 1.0 with other sources (98765432, here abcdef01)'
        """
        if self.version != client.version:
            return f"it has limbcli {self.version}, this is {client.version}"
        if self.code != client.code:
            return (
                f"it has limbcli {self.version} with other sources ({self.code[:8]}, here {client.code[:8]})"
            )
        if self.n_threads != 1:
            return f"it runs {self.n_threads} tasks at a time in one process, which may run only one"
        return ""


def is_installed() -> bool:
    return importlib.util.find_spec("distributed") is not None


def jobs_for(n_cases: int) -> int:
    """Number of local processes for `n_cases` cases, limited by the cores and the memory (2 GB each)."""
    from dask.system import CPU_COUNT
    from distributed.system import MEMORY_LIMIT

    return max(1, min(n_cases, CPU_COUNT, int(MEMORY_LIMIT / (_GB_A_WORKER * 1e9))))


def threads_of(jobs: int) -> int:
    """Threads for each of `jobs` local processes, such that their total does not exceed that of the cores."""
    from dask.system import CPU_COUNT

    return int(max(1, CPU_COUNT // jobs))


@contextlib.contextmanager
def connected(*, scheduler: str | None, jobs: int, progress: Progress) -> Iterator[Client]:
    """A client of the cluster at that address, or of `jobs` local processes, which end with the context.

    Raises ToolError if Dask is not installed, no scheduler answers, or a worker may not be used.
    """
    if not is_installed():
        raise ToolError(
            "Dask distributed, which is needed to use several processes, is not installed",
            where="--scheduler" if scheduler else "--jobs",
            fix=f"pip install 'limbcli[{EXTRA}]', or omit the option to run the cases one after the other "
            f"here",
        )
    import dask
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # the batch itself reports what matters
    with contextlib.ExitStack() as stack:
        if scheduler is None:
            folder = str(stack.enter_context(scratch_folder()))
            stack.enter_context(dask.config.set({"temporary-directory": folder}))
            client = stack.enter_context(Client(stack.enter_context(_local(jobs, folder))))
        else:
            client = stack.enter_context(_at(scheduler))
        refuse_unlike(client)
        workers = client.scheduler_info(n_workers=-1)["workers"]
        text = f"{len(workers)} worker processes" if workers else "no worker yet: waiting for the first"
        progress.event("note", text=f"{text}; dashboard: {client.dashboard_link}")
        yield client


def _local(jobs: int, folder: str) -> LocalCluster:
    """Start local processes; waiting parts queue at the scheduler and are not lost with a process.

    Raises ToolError if they do not start, e.g. because each new process would run the calling script again.
    """
    import dask
    from distributed import LocalCluster

    environment = dict.fromkeys((THREADS, *_LIBRARY_THREADS), str(threads_of(jobs)))
    preload = dask.config.get("distributed.worker.preload")
    try:
        with dask.config.set(_LOCAL):
            return LocalCluster(
                n_workers=jobs, threads_per_worker=1, processes=True, host="127.0.0.1",
                dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL, env=environment,
                local_directory=folder,
                preload=[*([preload] if isinstance(preload, str) else preload), __name__],
            )  # fmt: skip
    except RuntimeError as error:
        raise ToolError(
            f"the worker processes did not start ({error})",
            where="--jobs",
            fix='in a script, put the call below `if __name__ == "__main__":`; or use --jobs 1',
        ) from error


def dask_setup(_worker: Any) -> None:
    """Called by Dask when a local process starts: ignore Ctrl-C, as the batch ends all processes on it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _at(scheduler: str) -> Client:
    from distributed import Client

    try:
        return Client(scheduler, timeout=_WAIT_S)
    except (OSError, ValueError, TypeError) as error:
        raise ToolError(
            f"no scheduler answers at {scheduler} ({error or type(error).__name__})",
            where="--scheduler",
            fix="check that it is running and reachable from here; its log gives "
            "the address, such as tcp://10.0.0.5:8786",
        ) from error


def refuse_unlike(client: Client) -> None:
    """Check all currently connected workers.

    Raises ToolError if any of them runs different code from this process, or several parts at a time.
    """
    found = client.run(_standing, on_error="return")
    refused = {address: why for address, each in sorted(found.items()) if (why := _why_not(each))}
    if refused:
        raise ToolError(
            f"{len(refused)} of {len(found)} workers cannot be used: "
            + "; ".join(f"{address}: {why}" for address, why in list(refused.items())[:3])
            + ("; ..." if len(refused) > 3 else ""),
            where=str(client.scheduler.address) if client.scheduler else "--scheduler",
            fix=f"give them limbcli {__version__} as it is here (the same files), one "
            "thread each (dask worker --nthreads 1), and restart them",
            refused=refused,
        )


def _standing(dask_worker: Any) -> WorkerStanding:
    return WorkerStanding.own(dask_worker.state.nthreads)


def _why_not(found: WorkerStanding | BaseException) -> str:
    if isinstance(found, WorkerStanding):
        return found.why_not(WorkerStanding.own())
    return f"it has no compatible limbcli ({found})"


def refuse_other(client: WorkerStanding) -> None:
    """Check this worker before it runs a part; it may have joined after `refuse_unlike`.

    Raises WorkerRefused if this worker does not meet the client's requirements.
    """
    from distributed import get_worker

    worker = get_worker()
    why = WorkerStanding.own(worker.state.nthreads).why_not(client)
    if why:
        raise WorkerRefused(
            f"a worker rejected the work: {why}",
            where=f"{worker.address} on {platform.node()}",
            fix=f"give it limbcli {client.version} as it is where the batch was called, and restart it",
            worker=worker.address,
        )


@contextlib.contextmanager
def as_called(command: Sequence[str], threads: int) -> Iterator[None]:
    """On a worker: let results record the given command, and limit the number of threads."""
    from threadpoolctl import threadpool_limits

    environment = dict.fromkeys((THREADS, *_LIBRARY_THREADS), str(threads))
    before, own = {name: os.environ.get(name) for name in environment}, sys.argv
    os.environ.update(environment)
    sys.argv = list(command)
    try:
        with threadpool_limits(limits=threads):
            yield
    finally:
        sys.argv = own
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def lost_workers(client: Client) -> int:
    """Number of workers that ended unexpectedly since the scheduler was started."""
    events = client.get_events("all") or ()
    reported = [event for _, event in events if isinstance(event, dict)]
    return sum(each.get("action") == "remove-worker" and not each.get("expected") for each in reported)
