"""batch: run every stage of every case in order, repeating only what is out of date.

The failure of one site or case never stops the others: it is written to `error.json` in the
stage's folder, shown in the report and listed at the end of the batch. The work on a case is
divided into parts: `CaseRun.first`, `site`, `diagnosis` and `last`. There can be several `site`
and `diagnosis` parts, which can run in parallel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from limbcli.case import Case
from limbcli.errors import CaseError, LimbError
from limbcli.errors.pasted_commands import pasted
from limbcli.files.atomic import sha256
from limbcli.progress import SILENT, Progress
from limbcli.provenance.batch_memory import Memory, code_hash, key_of
from limbcli.provenance.requested_options import in_words, options_of
from limbcli.provenance.staleness import Chain
from limbcli.results import ERROR_FILE, StageResult, read_result, stage_folder
from limbcli.stages.batching.fits_on_demand import FitOnDemand, extras, made_by_hand
from limbcli.stages.batching.outcome import BatchOptions, CaseOutcome, FailedStage, keep_error, report_failure
from limbcli.stages.batching.steps import FIT_STATES, SITE_STAGES, parts_of, path_of, site_steps, templates_of
from limbcli.stages.machine.kernels import compile_ahead

DIAGNOSE = "diagnose"


def batch(
    folder: Path, *, out: Path, options: BatchOptions | None = None, progress: Progress = SILENT
) -> CaseOutcome:
    """Run all stages of one case; failures are recorded in the outcome and shown in the report.

    Raises CaseError if the folder does not exist.
    """
    case = opened(folder, out)
    if isinstance(case, CaseOutcome):
        return case
    run = CaseRun(case, out, options or BatchOptions(), progress)
    compile_ahead(solver="reference" if run.options.diagnose else run.options.solver, febio=run.options.febio)
    begun = run.first()
    keys = {site.name: run.site(site.name, begun.key) for site in case.sites} if begun.done else {}
    for place in begun.places:
        run.diagnosis(place, [keys[name] for name in place])
    run.last(begun.key, list(keys.values()))
    return run.outcome


def opened(folder: Path, out: Path) -> Case | CaseOutcome:
    """Open the case; if it cannot be read, write a report page that says why and return the failed outcome.

    Raises CaseError if the folder does not exist.
    """
    try:
        return Case.open_limb(folder)
    except CaseError as error:
        if not folder.is_dir():
            raise
        page = report_failure(folder, error, out=out).path("page")
        return CaseOutcome(folder, out, failures=[FailedStage("check", None, error)], report=page)


@dataclass(frozen=True)
class StartedCase:
    """Result of the first part of a case.

    key : hash of what the sites' stages depend on; done : whether those stages can be run
    places : names of the sites to be diagnosed together, one tuple per place
    """

    key: str
    done: bool
    places: tuple[tuple[str, ...], ...] = ()


class CaseRun:
    """The run of one case through the stages. before : failures of its parts in other processes"""

    def __init__(
        self, case: Case, out: Path, options: BatchOptions, progress: Progress,
        before: Sequence[FailedStage] = (),
    ):  # fmt: skip
        self.case, self.out, self.options, self.progress = case, out, options, progress
        self.outcome, self._before = CaseOutcome(case.folder, out), before
        self.memory = Memory(out, case.subject)
        self._of_sites: dict[str, Memory] = {}
        self.chain = Chain(case, out)

    @property
    def failures(self) -> list[FailedStage]:
        """Of all parts so far."""
        return [*self._before, *self.outcome.failures]

    def first(self) -> StartedCase:
        """Run `segment`, which all sites depend on."""
        from limbcli.stages.segment import SegmentOptions, edited_labels, segment

        edited = [path for path in [edited_labels(self.out)] if path]
        hints = self._requested("segment", None, without=("seeds", "threshold") if edited else ())
        key = key_of(code_hash(), self.case.subject, *edited, *parts_of(hints))
        options = options_of(SegmentOptions, hints)
        done = self._stage(
            "segment", None, key, lambda: segment(self.case, options=options, **self._common())
        )
        if not done:
            for site in self.case.sites:
                states = (FIT_STATES,) if site.states else ()
                self._skip((*SITE_STAGES, *states), site.name, because="segment")
        return StartedCase(key, done, self._places() if done and self.options.diagnose else ())

    def _places(self) -> tuple[tuple[str, ...], ...]:
        from limbcli.stages.diagnose import places

        found = places(self.case, self.case.sites, out=self.out)
        return tuple(tuple(site.name for site in place) for place in found)

    def diagnosis(self, names: Sequence[str], keys: Sequence[str]) -> None:
        """Diagnose sites that share a place.

        A diagnosis made by hand is kept for as long as it is valid.
        keys : those of the last stage of each site
        """
        from limbcli.stages.diagnose import DiagnoseOptions, diagnose

        requested = self._requested(DIAGNOSE, names[0])
        files = [path for path in map(path_of, map(requested.get, ("effect_file", "templates"))) if path]
        key = key_of(DIAGNOSE, *names, *keys, *parts_of(requested), *files)
        for failure in self.failures:
            if failure.site in names and failure.stage not in (SITE_STAGES[-1], FIT_STATES):
                for name in names:
                    self._skip((DIAGNOSE,), name, because=f"{failure.stage} {failure.site}")
                return
        of_batch = {"solver": self.options.solver, "febio": self.options.febio}
        if self.options.templates:
            of_batch["templates"] = self.options.templates
        options = options_of(DiagnoseOptions, {**requested, **of_batch})

        def work() -> object:
            return diagnose(self.case, sites=list(names), options=options, **self._common())

        self._stage(DIAGNOSE, names[0], key, work, beside=names[1:], keeps_manual=True)

    def last(self, first: str, keys: Sequence[str]) -> None:
        """Update what depends on all sites: the fits made on demand, and the report.

        first, keys : keys of the first part and of each site's part
        """
        from limbcli.stages.report import report

        made = [self._extra(each, keys) for each in extras(self.case, self.out, progress=self.progress)]
        made += self._in_socket(first, keys)
        failed = [str(each.error) for each in self.failures]
        requested = self._requested("report", None)
        templates, _ = templates_of(self.options, requested)
        own = [templates] if templates else []
        shown = self.case.raw  # also what no stage asks for, such as the name of the probe
        everything = key_of(first, *keys, *made, *self._records(), shown, failed, *own)

        def work() -> object:
            return report(self.case, templates=templates, **self._common())

        if self._stage("report", None, everything, work):
            self.outcome.report = stage_folder(self.out, "report") / "report.html"

    def _in_socket(self, first: str, keys: Sequence[str]) -> list[str]:
        """Run `limb` and `socket` (without intervals) for a case with a socket; return their keys."""
        from limbcli.case.socket import socket_of

        given = socket_of(self.case)
        if given is None:
            return []
        if any(each.stage == "segment" for each in self.failures):
            self._skip(("limb", "socket"), None, because="segment")
            return []
        from limbcli.stages.limb import LimbOptions, limb
        from limbcli.stages.socket import SocketOptions, socket

        asked = {name: self._requested(name, None) for name in ("limb", "socket")}
        sized = {"nodes": given.limb_nodes, **asked["limb"]}
        fits = [
            site.name
            for site in self.case.sites
            if (stage_folder(self.out, "fit", site.name) / "fit.json").is_file()
        ]
        of_limb, used_by_limb = templates_of(self.options, asked["limb"])
        of_socket, used_by_socket = templates_of(self.options, asked["socket"])
        key = key_of("limb", first, *keys, *used_by_limb, fits, *parts_of(sized))

        def model() -> object:
            options = options_of(LimbOptions, sized)
            return limb(self.case, options=options, templates=of_limb, **self._common())

        def pressed() -> object:
            options = options_of(SocketOptions, {"intervals": False, **asked["socket"]})
            return socket(self.case, options=options, templates=of_socket, **self._common())

        if not self._stage("limb", None, key, model):
            self._skip(("socket",), None, because="limb")
            return [key]
        own = key_of("socket", key, *used_by_socket, *parts_of(asked["socket"]))
        self._stage("socket", None, own, pressed, keeps_manual=True)  # perhaps with intervals
        return [key, own]

    def keep(self, failure: FailedStage) -> None:
        """Record a failure for the report, in case its process was lost before it could do so itself."""
        stage, site = failure.stage, failure.site
        if (stage_folder(self.out, stage, site) / ERROR_FILE).is_file():
            return
        keep_error(self.out, stage, site, failure.error)
        if site is None:
            for each in self.case.sites if stage == "segment" else ():
                self._skip(SITE_STAGES, each.name, because=stage)
        elif stage in SITE_STAGES:
            self._skip(SITE_STAGES[SITE_STAGES.index(stage) + 1 :], site, because=stage)

    def _extra(self, extra: FitOnDemand, keys: Sequence[str]) -> str:
        """Bring a fit made on demand up to date; return the hash of its folder, for the report's key."""
        folder = stage_folder(self.out, extra.stage, extra.site)
        by_site = zip(self.case.sites, keys, strict=False)
        key = key_of(extra.stage, *(each for site, each in by_site if site.name in extra.sites))
        sound = extra.is_current and not (folder / ERROR_FILE).exists()
        if sound and self.memory.made_since(extra.stage, extra.site):
            self.memory.remember(extra.stage, extra.site, key)
        failed = [each for each in self.failures if each.site in (None, *extra.sites)]
        if failed:
            self._skip((extra.stage,), extra.site, because=failed[0].stage, keep_result=True)
        else:
            self._stage(extra.stage, extra.site, key, extra.redo, keep_result=True)
        return sha256(folder)

    def _memory(self, stage: str, site: str | None) -> Memory:
        """Each site has its own memory because the parts of a case may run in parallel."""
        if site is None or stage not in (*SITE_STAGES, FIT_STATES, DIAGNOSE):
            return self.memory
        if site not in self._of_sites:
            self._of_sites[site] = Memory(self.out, self.case.subject, site=site)
        return self._of_sites[site]

    def _requested(self, stage: str, site: str | None, *, without: Sequence[str] = ()) -> dict[str, Any]:
        """Options of the stage's last manual call; stored for later batches and reported.

        without : options not returned because another one takes precedence, as the batch's own templates do
        """
        memory = self._memory(stage, site)
        requested = {} if self.options.defaults else memory.requested(stage, site)
        memory.keep_requested(stage, site, requested)
        left_out = {*without, *(["templates"] if self.options.templates else [])}
        requested = {key: value for key, value in requested.items() if key not in left_out}
        if requested:
            label, words = f"{stage} {site}" if site else stage, in_words(requested)
            self.outcome.kept[label] = words
            self.progress.event(
                "note",
                text=f"{label}: with the options of the last manual call, {words} (--defaults: without)",
            )
        return requested

    def _common(self) -> dict[str, Any]:
        return {"out": self.out, "progress": self.progress}

    def site(self, name: str, key: str) -> str:
        """Run the stages of one site; return the key of the last one, for the report's key."""
        without = {"mesh": ("element",) if self.options.element else ()}
        stages = (*SITE_STAGES, *([FIT_STATES] if self.case.site(name).states else []))
        requested = {each: self._requested(each, name, without=without.get(each, ())) for each in stages}
        steps = site_steps(self.case, name, self.options, requested, out=self.out, progress=self.progress)
        for k, step in enumerate(steps):
            stage, key = step.stage, key_of(key, *step.parts)
            if stage == "fit" and self._fit_is_there(name):
                self._memory(stage, name).remember(stage, name, key)
            if not self._stage(stage, name, key, step.work):
                self._skip(stages[k + 1 :], name, because=stage)
                break
        return key

    def _fit_is_there(self, site: str) -> bool:
        """Whether an existing fit made by hand is the one that this batch would make."""
        made = self._memory("fit", site).made_since("fit", site) and not self.options.defaults
        return made and made_by_hand(self.case, self.out, site, solver=self.options.solver)

    def _skip(
        self, stages: Sequence[str], site: str | None, *, because: str, keep_result: bool = False
    ) -> None:
        """Mark stages that cannot run as failed, which invalidates their earlier results.

        because : the stage whose failure prevents them; keep_result : keep the earlier result's file
        """
        for stage in stages:
            memory = self._memory(stage, site)
            if not self.options.defaults:  # the result that holds the options given by hand is removed
                memory.keep_requested(stage, site, memory.requested(stage, site))
            error = CaseError(
                f"`{stage}` was not run, because `{because}` failed",
                where=f"site {site}" if site else str(self.case.folder),
                fix=f"resolve what `{because}` reports, then run the batch again",
            )
            keep_error(self.out, stage, site, error, keep_result=keep_result)

    def _stage(
        self, stage: str, site: str | None, key: str, work: Callable[[], object], *,
        keep_result: bool = False, beside: Sequence[str] = (), keeps_manual: bool = False,
    ) -> bool:  # fmt: skip
        """Run a stage unless its result is up to date; False if it failed.

        keep_result : keep the earlier result if the stage fails
        beside : other sites whose results the same work writes
        keeps_manual : a result made by hand counts as up to date for as long as it is valid
        """
        label = f"{stage} {site}" if site else stage
        memories = {each: self._memory(stage, each) for each in (site, *beside)}
        if (
            keeps_manual
            and not self.options.defaults
            and all(
                memory.made_since(stage, each) and self._holds(stage, each)
                for each, memory in memories.items()
            )
        ):
            for each, memory in memories.items():
                memory.remember(stage, each, key)
        if not self.options.force and all(
            memory.is_fresh(stage, each, key) and self._holds(stage, each)
            for each, memory in memories.items()
        ):
            self.outcome.fresh.append(label)
            self.progress.event("note", text=f"{label}: nothing changed")
            return True
        self.progress.event("stage", name=stage, site=site)
        try:
            self._pass_on(work())
        except LimbError as raised:
            error = pasted(raised, self.case.folder, self.out)
            self.outcome.failures.append(FailedStage(stage, site, error))
            for each in memories:
                keep_error(self.out, stage, each, error, keep_result=keep_result)
            self.progress.event("note", text=f"{type(error).__name__}: {error.what}")
            return False
        for each, memory in memories.items():
            memory.remember(stage, each, key)
        self.outcome.ran.append(label)
        return True

    def _records(self) -> list[Path]:
        """The records of all results, which the report shows."""
        stages = [each for each in sorted(self.out.iterdir()) if each.is_dir() and each.name != "report"]
        paths = [
            path
            for each in stages
            for path in [each / f"{each.name}.json", *sorted(each.glob(f"*/{each.name}.json"))]
        ]
        return [path for path in paths if path.is_file()]

    def _holds(self, stage: str, site: str | None) -> bool:
        """Whether all inputs of a result are unchanged, including those in no key (such as a place)."""
        try:
            return self.chain.broken(read_result(self.out, stage, site=site)) is None
        except CaseError:
            return False

    def _pass_on(self, results: object) -> None:
        for each in results if isinstance(results, Sequence) else [results]:
            if isinstance(each, StageResult):
                for line in (*each.summary, *(f"warning: {text}" for text in each.warnings)):
                    self.progress.event("note", text=line)
