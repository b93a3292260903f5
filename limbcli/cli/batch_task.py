"""What one process does of a batch that several share: one part of one case."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from limbcli.errors import LimbError
from limbcli.progress import Progress
from limbcli.stages.batch import SITE_STAGES, Begun, CaseRun, opened
from limbcli.stages.batch_outcome import BatchOptions, CaseOutcome, Failure
from limbcli.stages.cluster import Standing, as_called, refuse_other

FIRST, SITE, LAST = "first", "site", "last"
FIRST_STAGE = {FIRST: "segment", SITE: SITE_STAGES[0], LAST: "report"}
NOT_BEGUN = Begun("", done=False)
Tell = Callable[[str, dict[str, Any]], None]


@dataclass(frozen=True)
class Call:
    """What all parts of a batch share.

    client : the code that calls; threads : of each process; topic : of Dask's events, for progress
    """

    client: Standing
    command: tuple[str, ...]
    threads: int
    topic: str
    wait: bool
    options: BatchOptions


@dataclass(frozen=True)
class Part:
    """A case's first or last part, or one of its sites'.

    begun, keys : what the parts before left; outcome : how the case went so far, for the last
    """

    case: Path
    out: Path
    kind: str
    site: str | None = None
    begun: Begun = NOT_BEGUN
    keys: tuple[str, ...] = ()
    outcome: CaseOutcome | None = None

    @property
    def name(self) -> str:
        return f"{self.case.name} {self.site}" if self.site else self.case.name


@dataclass(frozen=True)
class Done:
    """sites : of the case, after its first part; key : of what a site's part left
    is_all : nothing follows
    """

    outcome: CaseOutcome
    begun: Begun = NOT_BEGUN
    sites: tuple[str, ...] = ()
    key: str = ""
    is_all: bool = False


def work(part: Part, call: Call) -> Done:
    """One part, on a worker; whatever goes wrong with it is in its outcome.

    Raises
    ------
    WorkerRefused
        If this worker's code is not the client's.
    """
    from distributed import get_worker

    refuse_other(call.client)
    worker = get_worker()

    def tell(kind: str, facts: dict[str, Any]) -> None:
        if kind in ("stage", "note"):
            worker.log_event(call.topic, {"part": part.name, "kind": kind, **facts})

    with as_called(call.command, call.threads):
        return done(part, call, tell)


def done(part: Part, call: Call, tell: Tell) -> Done:
    """The same in this process; `tell` hears of its progress."""
    heard = _Heard(FIRST_STAGE[part.kind])
    progress = Progress(heard, tell)
    outcome = CaseOutcome(part.case, part.out)
    try:
        return {FIRST: _first, SITE: _site, LAST: _last}[part.kind](part, call, progress)
    except Exception as error:  # one part's fault never stops the others
        outcome.failures.append(Failure(heard.stage, part.site, in_words(error, part.out)))
    return Done(outcome, is_all=not part.case.is_dir())


def in_words(error: Exception, out: Path) -> LimbError:
    """The error that a person reads; what nobody foresaw leaves a file in the output folder."""
    from limbcli.cli.last_net import unforeseen
    from limbcli.faults import in_words as in_words_of_system

    if isinstance(error, LimbError):
        return error
    known = in_words_of_system(error, out) if isinstance(error, OSError) else None
    return known or unforeseen(error, out if out.is_dir() else None)


@dataclass
class _Heard:
    """Listens for the stage that is on."""

    stage: str

    def __call__(self, kind: str, facts: dict[str, Any]) -> None:
        if kind == "stage":
            self.stage = str(facts["name"])


def _first(part: Part, call: Call, progress: Progress) -> Done:
    from limbcli.cli.writing import one_writer

    turn = one_writer(part.out, wait=call.wait, progress=progress)
    with turn if part.case.is_dir() else contextlib.nullcontext():
        case = opened(part.case, part.out)
        if isinstance(case, CaseOutcome):
            return Done(case, is_all=True)
        run = CaseRun(case, part.out, call.options, progress)
        begun = run.first()
    return Done(run.outcome, begun, tuple(site.name for site in case.sites))


def _site(part: Part, call: Call, progress: Progress) -> Done:
    from limbcli.case import Case
    from limbcli.cli.writing import site_writer

    assert part.site is not None
    with site_writer(part.out, part.site, wait=call.wait, progress=progress):
        run = CaseRun(Case.open(part.case), part.out, call.options, progress)
        key = run.site(part.site, part.begun.key)
    return Done(run.outcome, part.begun, key=key)


def _last(part: Part, call: Call, progress: Progress) -> Done:
    from limbcli.case import Case
    from limbcli.cli.writing import one_writer

    assert part.outcome is not None
    earlier = part.outcome.failures
    with one_writer(part.out, wait=call.wait, progress=progress):
        own = CaseOutcome(part.case, part.out, failures=list(earlier))
        run = CaseRun(Case.open(part.case), part.out, call.options, progress, own)
        for each in earlier:
            run.keep(each)
        run.last(part.begun.key, part.keys)
    del own.failures[: len(earlier)]
    return Done(own, part.begun, is_all=True)
