"""One part of one case: the unit of work that a process takes from a batch shared by several processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any

from limbcli.case import Case
from limbcli.errors import LimbError
from limbcli.files.output_lock import one_writer, site_writer
from limbcli.progress import Listener, Progress
from limbcli.results import CALLED
from limbcli.stages.batch import DIAGNOSE, CaseRun, StartedCase, opened
from limbcli.stages.batching.cluster import WorkerStanding, as_called, refuse_other
from limbcli.stages.batching.outcome import BatchOptions, CaseOutcome, FailedStage
from limbcli.stages.batching.steps import SITE_STAGES

FIRST, SITE, DIAGNOSIS, LAST = "first", "site", "diagnosis", "last"
FIRST_STAGE = {FIRST: "segment", SITE: SITE_STAGES[0], DIAGNOSIS: DIAGNOSE, LAST: "report"}
NOT_BEGUN = StartedCase("", done=False)


@dataclass(frozen=True, kw_only=True)
class Call:
    """Settings common to all parts of a batch.

    client : version and source hash of the calling process; typed_options : the options as typed on the
        command line; called : the call, if it was made from Python; threads : number for each process
    topic : Dask's topic for progress events; event_interval_s : longest time without an event while work
        progresses (s)
    """

    client: WorkerStanding
    typed_options: tuple[str, ...]
    called: str
    threads: int
    topic: str
    event_interval_s: float
    wait: bool
    options: BatchOptions


@dataclass(frozen=True)
class BatchTask:
    """A part of a case: its first, its last, that of one site, or the diagnosis of sites sharing a place.

    begun, keys, failures : results of the preceding parts of the case
    """

    case: Path
    out: Path
    kind: str
    _: KW_ONLY
    sites: tuple[str, ...] = ()
    begun: StartedCase = NOT_BEGUN
    keys: tuple[str, ...] = ()
    failures: tuple[FailedStage, ...] = ()

    @property
    def name(self) -> str:
        return " ".join(each for each in (self.case.name, "+".join(self.sites)) if each)

    @property
    def site(self) -> str | None:
        """The first of the part's sites."""
        return self.sites[0] if self.sites else None


@dataclass(frozen=True)
class PartOutcome:
    """Outcome of a part.

    sites : the case's sites, from its first part; key : key of the last stage, from a site's part
    is_all : whether no part follows the first
    """

    outcome: CaseOutcome
    begun: StartedCase = NOT_BEGUN
    sites: tuple[str, ...] = ()
    key: str = ""
    is_all: bool = False


def work(part: BatchTask, call: Call) -> PartOutcome:
    """Run one part on a worker; its errors are recorded in its outcome.

    Raises WorkerRefused if this worker's code differs from the client's.
    """
    from distributed import get_worker

    refuse_other(call.client)
    worker = get_worker()

    event_log = _EventLog(part.name, call.event_interval_s, lambda event: worker.log_event(call.topic, event))
    command = ["limbcli", "batch", str(part.case), "--out", str(part.out), *call.typed_options]
    with as_called(command, call.threads):
        before = CALLED.set(call.called)
        try:
            return done(part, call, event_log)
        finally:
            CALLED.reset(before)


class _EventLog:
    """Forwards each change of stage, notes about waiting for a lock, and periodic signs of progress."""

    def __init__(self, part: str, every_s: float, send: Callable[[dict[str, Any]], None]):
        self._part, self._every_s, self._send = part, every_s, send
        self._stage, self._last = "", 0.0

    def __call__(self, kind: str, facts: dict[str, Any]) -> None:
        if kind == "stage":
            is_new, self._stage = facts["name"] != self._stage, str(facts["name"])
        else:
            is_new = kind == "note" and bool(facts.get("waiting"))
        if is_new or time.monotonic() - self._last > self._every_s:
            self._last = time.monotonic()
            text = facts["text"] if is_new and kind == "note" else ""
            self._send({"part": self._part, "stage": self._stage, "text": text})


def done(part: BatchTask, call: Call, listener: Listener) -> PartOutcome:
    """Run one part in this process; its errors are recorded in its outcome.

    listener : called with each progress event
    """
    heard = _Heard("check" if part.kind == FIRST else FIRST_STAGE[part.kind])
    progress = Progress(heard, listener)
    outcome = CaseOutcome(part.case, part.out)
    try:
        return _KINDS[part.kind](part, call, progress)
    except Exception as error:  # an error in one part never stops the others
        outcome.failures.append(FailedStage(heard.stage, part.site, in_words(error, part.out)))
    return PartOutcome(outcome, is_all=not part.case.is_dir())


def in_words(error: Exception, out: Path) -> LimbError:
    """The error as shown to the user; an unexpected one is also written to a file in the output folder."""
    from limbcli.errors.file_system import in_words as in_words_of_system
    from limbcli.errors.unexpected import unforeseen

    if isinstance(error, LimbError):
        return error
    known = in_words_of_system(error, out) if isinstance(error, OSError) else None
    return known or unforeseen(error, out if out.is_dir() else None)


@dataclass
class _Heard:
    """Listener that keeps the name of the current stage."""

    stage: str

    def __call__(self, kind: str, facts: dict[str, Any]) -> None:
        if kind == "stage":
            self.stage = str(facts["name"])


def _first(part: BatchTask, call: Call, progress: Progress) -> PartOutcome:
    turn = one_writer(part.out, wait=call.wait, progress=progress)
    with turn if part.case.is_dir() else nullcontext():
        case = opened(part.case, part.out)
        if isinstance(case, CaseOutcome):
            return PartOutcome(case, is_all=True)
        run = CaseRun(case, part.out, call.options, progress)
        begun = run.first()
    return PartOutcome(run.outcome, begun, tuple(site.name for site in case.sites))


def _site(part: BatchTask, call: Call, progress: Progress) -> PartOutcome:
    assert part.site is not None
    with site_writer(part.out, part.site, wait=call.wait, progress=progress):
        run = _opened_run(part, call, progress)
        key = run.site(part.site, part.begun.key)
    return PartOutcome(run.outcome, key=key)


def _diagnosis(part: BatchTask, call: Call, progress: Progress) -> PartOutcome:
    with ExitStack() as turns:
        for site in sorted(part.sites):  # always in the same order, to prevent deadlock
            turns.enter_context(site_writer(part.out, site, wait=call.wait, progress=progress))
        run = _opened_run(part, call, progress)
        run.diagnosis(part.sites, part.keys)
    return PartOutcome(run.outcome)


def _last(part: BatchTask, call: Call, progress: Progress) -> PartOutcome:
    with one_writer(part.out, wait=call.wait, progress=progress):
        run = _opened_run(part, call, progress)
        for each in part.failures:
            run.keep(each)
        run.last(part.begun.key, part.keys)
    return PartOutcome(run.outcome)


def _opened_run(part: BatchTask, call: Call, progress: Progress) -> CaseRun:
    return CaseRun(Case.open_limb(part.case), part.out, call.options, progress, before=part.failures)


_KINDS = {FIRST: _first, SITE: _site, DIAGNOSIS: _diagnosis, LAST: _last}
