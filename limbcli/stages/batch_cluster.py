"""A batch shared by several processes: schedules the parts of each case and collects their outcomes."""

from __future__ import annotations

import contextlib
import itertools
import sys
import threading
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from limbcli.errors import LimbError, ToolError
from limbcli.progress import Progress
from limbcli.results import CALLED
from limbcli.stages.batch_task import (
    DIAGNOSIS,
    FIRST,
    FIRST_STAGE,
    LAST,
    NOT_BEGUN,
    SITE,
    BatchTask,
    Call,
    PartOutcome,
    work,
)
from limbcli.stages.batching.cluster import WorkerRefused, WorkerStanding, connected, lost_workers, threads_of
from limbcli.stages.batching.outcome import BatchOptions, CaseOutcome, FailedStage

if TYPE_CHECKING:
    from distributed import Client, Future

_EVENT_INTERVAL_S = 4.0  # s, minimum interval between two progress events of a part; longer with many workers
_LOOK_S = 10.0  # s between two checks whether any worker is left
_SAME = "call the same batch again: finished work is not repeated"


@dataclass
class CaseProgress:
    """Progress of one case: the results of its parts so far."""

    place: int
    outcome: CaseOutcome
    first: PartOutcome | None = None
    keys: dict[str, str] = field(default_factory=dict)  # by site, where it has ended
    places: list[tuple[str, ...]] = field(default_factory=list)  # that are still to be diagnosed
    n_open: int = 0  # parts that are in work

    @property
    def name(self) -> str:
        return self.outcome.case.name


def together(
    cases: Sequence[tuple[Path, Path]], options: BatchOptions, *, scheduler: str | None, jobs: int,
    wait: bool, progress: Progress,
) -> list[CaseOutcome]:  # fmt: skip
    """Run all (case, output folder) pairs on a cluster or in `jobs` local processes; outcomes in input order.

    Raises ToolError if no scheduler answers, a worker runs different code, or the scheduler is lost during
    the run.
    """
    with connected(scheduler=scheduler, jobs=jobs, progress=progress) as client:
        n_workers = len(client.scheduler_info(n_workers=-1)["workers"])
        call = Call(
            client=WorkerStanding.own(), typed_options=options_of_call(sys.argv, [case for case, _ in cases]),
            called=CALLED.get(), threads=threads_of(jobs) if scheduler is None else 1,
            topic=f"limbcli-{uuid.uuid4().hex}",
            event_interval_s=max(_EVENT_INTERVAL_S, n_workers / 2), wait=wait,
            options=options,
        )  # fmt: skip
        return _Together(client, call, cases, progress).run()


def options_of_call(command: Sequence[str], cases: Sequence[Path]) -> tuple[str, ...]:
    """A command line's options without the cases and the output folder, which differ from part to part.

    >>> options_of_call(["limbcli", "batch", "a", "--out", "out", "--element", "tet4"], [Path("a")])
    ('--element', 'tet4')
    """
    own = {str(each.absolute()) for each in cases}
    found: list[str] = []
    for before, word in itertools.pairwise(["", *command[2:]]):
        is_out = before in ("--out", "-o") or word in ("--out", "-o") or word.startswith("--out=")
        is_case = not word.startswith("-") and str(Path(word).absolute()) in own
        found += [] if is_out or is_case else [word]
    return tuple(found)


class _Together:
    def __init__(self, client: Client, call: Call, cases: Sequence[tuple[Path, Path]], progress: Progress):
        self.client, self.call, self.progress = client, call, progress
        self.ways = [CaseProgress(k, CaseOutcome(case, out)) for k, (case, out) in enumerate(cases)]
        self.parts: dict[Any, tuple[CaseProgress, BatchTask]] = {}
        self.stages: dict[str, str] = {}  # by part name, the stage that it last reported
        self.refused: set[str] = set()  # addresses of workers
        self.n_parts, self.n_done, self.n_cases_done = len(self.ways), 0, 0
        self._begun, self._speaking = time.monotonic(), threading.Lock()

    def run(self) -> list[CaseOutcome]:
        from distributed import as_completed

        before = lost_workers(self.client)
        self.client.subscribe_topic(self.call.topic, self._hear)
        over = threading.Event()
        threading.Thread(target=self._watch, args=(over,), daemon=True).start()
        futures = [self._part(way, FIRST) for way in self.ways]
        try:
            running = as_completed(futures)
            for future in running:
                running.update(self._next(future))
        finally:
            over.set()
            with contextlib.suppress(Exception):  # if the scheduler is gone, there is nothing to notify
                self.client.cancel(list(self.parts), force=True)
                self.client.unsubscribe_topic(self.call.topic)
        lost = lost_workers(self.client) - before
        if lost > 0:
            self._publish(
                "note", text=f"worker processes lost during the run: {lost}; their work was done by others"
            )
        return [way.outcome for way in self.ways]

    # ------------------------------------------------------------ parts

    def _part(
        self, way: CaseProgress, kind: str, *, sites: tuple[str, ...] = (), keys: tuple[str, ...] = ()
    ) -> Future:
        outcome, begun = way.outcome, NOT_BEGUN if way.first is None else way.first.begun
        failures = tuple(outcome.failures)
        part = BatchTask(
            outcome.case, outcome.out, kind, sites=sites, begun=begun, keys=keys, failures=failures
        )
        return self._submit(way, part)

    def _submit(self, way: CaseProgress, part: BatchTask) -> Future:
        """Submit a part; parts of earlier cases have priority, so that cases finish one after the other."""
        way.n_open += 1
        # Dask groups tasks by the part of the key before the number. Tasks of a large group are queued at the
        # scheduler rather than at a worker, which may be lost.
        key = f"{part.kind}-0-{part.name.replace(' ', '-')}-{uuid.uuid4().hex}"
        future = self.client.submit(
            work, part, self.call, key=key, pure=False, priority=-way.place, workers=self._usable(),
        )  # fmt: skip
        self.parts[future] = way, part
        return future

    def _usable(self) -> list[str] | None:
        """Addresses of the workers that have not refused; None if any worker may be used.

        Raises ToolError if all workers have refused.
        """
        if not self.refused:
            return None
        there = set(self.client.scheduler_info(n_workers=-1)["workers"]) - self.refused
        if not there:
            raise ToolError(
                f"all workers rejected the work: {', '.join(sorted(self.refused))}",
                where=str(self.client.scheduler.address) if self.client.scheduler else "--scheduler",
                fix="install this computer's limbcli on them (the same files), and restart them",
            )
        return sorted(there)

    def _next(self, future: Future) -> list[Future]:
        """Record the outcome of a part; return the newly submitted parts."""
        way, part = self.parts.pop(future)
        way.n_open -= 1
        try:
            done = future.result()
        except WorkerRefused as error:
            self._refuse(error)
            return [self._submit(way, part)]
        except Exception as error:  # errors within a part are in its outcome; this one came from Dask
            done = self._without_answer(way, part, error)
        future.release()
        self.n_done += 1
        way.outcome.add(done.outcome)
        if part.kind == FIRST:
            return self._after_first(way, done)
        if part.kind == SITE:
            assert part.site is not None
            way.keys[part.site] = done.key
        if part.kind in (SITE, DIAGNOSIS):
            return self._diagnoses(way) or (self._last(way) if way.n_open == 0 else [])
        return self._ended(way)

    def _after_first(self, way: CaseProgress, done: PartOutcome) -> list[Future]:
        way.first = done
        segmented = any(each.stage == FIRST_STAGE[FIRST] for each in done.outcome.failures)
        if done.is_all or not (done.sites or segmented):
            return self._ended(way)
        sites = done.sites if done.begun.done else ()
        way.places = list(done.begun.places)
        self.n_parts += len(sites) + len(way.places) + 1
        if not sites:
            return self._last(way)
        return [self._part(way, SITE, sites=(site,)) for site in sites]

    def _diagnoses(self, way: CaseProgress) -> list[Future]:
        """Submit the diagnosis of each place whose sites have all finished."""
        ready = [place for place in way.places if way.keys.keys() >= set(place)]
        way.places = [place for place in way.places if place not in ready]
        return [
            self._part(way, DIAGNOSIS, sites=place, keys=tuple(way.keys[name] for name in place))
            for place in ready
        ]

    def _last(self, way: CaseProgress) -> list[Future]:
        assert way.first is not None
        keys = tuple(way.keys[site] for site in way.first.sites if site in way.keys)
        return [self._part(way, LAST, keys=keys)]

    def _ended(self, way: CaseProgress) -> list[Future]:
        self.n_cases_done += 1
        failures = way.outcome.failures
        how = "; ".join(f"{each.place} failed: {each.error.what}" for each in failures) or "done"
        if not failures and not way.outcome.ran:
            how = "nothing changed"
        self._publish("note", text=f"{way.name}: {how}")
        self._count("")
        return []

    # ------------------------------------------------------------ what goes wrong

    def _refuse(self, error: WorkerRefused) -> None:
        address = str(error.facts["worker"])
        if address not in self.refused:
            self.refused.add(address)
            self._publish("note", text=f"{error.what} ({error.where}); other workers take over. {error.fix}")

    def _without_answer(self, way: CaseProgress, part: BatchTask, error: Exception) -> PartOutcome:
        """A failed outcome for a part that Dask abandoned.

        Raises ToolError if the connection to the scheduler is lost.
        """
        from distributed import KilledWorker

        if not isinstance(error, KilledWorker) and self.client.status != "running":
            raise ToolError(
                f"the scheduler was lost when {self.n_cases_done} of {len(self.ways)} cases were done "
                f"({type(error).__name__})",
                where="--scheduler",
                fix=f"check its log, restart it, and {_SAME}",
            ) from error
        reported: LimbError
        if isinstance(error, KilledWorker):
            reported = ToolError(
                f"every process that worked on it was lost ({1 + error.allowed_failures} in turn)",
                where=part.name,
                fix="check whether the memory is sufficient (fewer --jobs, more memory per worker); " + _SAME,
            )
        else:
            text = f"the cluster abandoned it ({type(error).__name__}: {error})"
            reported = ToolError(text, where=part.name, fix=f"check the workers' logs; {_SAME}")
        stage = self.stages.get(part.name, FIRST_STAGE[part.kind])
        outcome = CaseOutcome(part.case, part.out, failures=[FailedStage(stage, part.site, reported)])
        return PartOutcome(outcome)

    # ------------------------------------------------------------ progress

    def _hear(self, event: tuple[float, dict[str, Any]]) -> None:
        """Handle a progress event of a worker (called in Dask's own thread)."""
        facts = event[1]
        part, stage = facts["part"], facts["stage"]
        if facts["text"]:
            self._publish("note", text=f"{part}: {facts['text']}")
            return
        if stage:
            self.stages[part] = stage
        self._count(f"{part}: {stage}" if stage else part)

    def _watch(self, over: threading.Event) -> None:
        """Report when no worker is left and when one is available again (runs in its own thread)."""
        there = True  # at the start, `connected` reports a lack of workers
        while not over.wait(_LOOK_S):
            try:
                n_workers = len(self.client.scheduler_info(n_workers=-1)["workers"])
            except Exception:  # the scheduler is gone: the main thread raises the error
                return
            if there and not n_workers:
                self._publish("note", text="no worker is left: waiting for one (restart jobs that ended)")
            elif n_workers and not there:
                self._publish("note", text=f"workers are available again: {n_workers}")
            there = bool(n_workers)

    def _count(self, now: str) -> None:
        left = self._left()
        self._publish(
            "task", name=", ".join(each for each in ("cases", now, left) if each),
            done=self.n_cases_done, total=len(self.ways),
        )  # fmt: skip

    def _left(self) -> str:
        """Estimated remaining time, from the mean time per finished part; empty before the first."""
        if not self.n_done or self.n_done >= self.n_parts:
            return ""
        each = (time.monotonic() - self._begun) / self.n_done
        minutes = each * (self.n_parts - self.n_done) / 60
        return f"about {minutes:.0f} min left" if minutes >= 1 else "less than a minute left"

    def _publish(self, kind: str, **facts: Any) -> None:
        with self._speaking:
            self.progress.event(kind, **facts)
