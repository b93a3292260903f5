"""batch: every stage of every case, in order, redoing only what changed.

One site's or one case's failure never stops the others: it is kept as
`error.json` in the stage's folder, the report shows it, and the batch says so at
its end.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from limbcli.case import Case
from limbcli.errors import CaseError, LimbError
from limbcli.files import atomic_file, sha256
from limbcli.pasting import pasted
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, plain, read_result, stage_folder
from limbcli.stages.asked import in_words, options_of
from limbcli.stages.chain import Chain
from limbcli.stages.extras import Extra, extras, made_by_hand, shown_only
from limbcli.stages.freshness import Memory, code_hash, key_of

ERROR_FILE = "error.json"


@dataclass(frozen=True)
class BatchOptions:
    """What the stages are told: `element` None is the case's own; `force` redoes everything.

    defaults : stages forget what they were asked for by hand; else each is called as it was last called
    """

    element: str | None = None
    solver: str = "auto"
    febio: Path | None = None
    templates: Path | None = None
    force: bool = False
    defaults: bool = False


@dataclass(frozen=True)
class Failure:
    stage: str
    site: str | None
    error: LimbError


@dataclass
class CaseOutcome:
    """How one case went: what ran, what was fresh, what failed, and its report.

    kept : options that a stage was called with by hand and is called with again, in words
    """

    case: Path
    out: Path
    ran: list[str] = field(default_factory=list)
    fresh: list[str] = field(default_factory=list)
    kept: dict[str, str] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    report: Path | None = None

    def to_json(self) -> dict[str, Any]:
        return {
            "case": str(self.case),
            "out": str(self.out),
            "ran": self.ran,
            "fresh": self.fresh,
            "kept": self.kept,
            "failures": [
                {"stage": each.stage, "site": each.site, **error_json(each.error)} for each in self.failures
            ],
            "report": str(self.report) if self.report else None,
        }


def batch(
    folder: Path, *, out: Path, options: BatchOptions | None = None, progress: Progress = SILENT
) -> CaseOutcome:
    """Run one case through all stages; whatever fails is in the outcome and on its page.

    Raises
    ------
    CaseError
        If there is no such folder.
    """
    from limbcli.stages.report_failure import report_failure

    try:
        case = Case.open(folder)
    except CaseError as error:
        if not folder.is_dir():
            raise
        page = report_failure(folder, error, out=out).path("page")
        return CaseOutcome(folder, out, failures=[Failure("check", None, error)], report=page)
    return _Run(case, out, options or BatchOptions(), progress).all()


class _Run:
    """One case on its way through the stages."""

    def __init__(self, case: Case, out: Path, options: BatchOptions, progress: Progress):
        self.case, self.out, self.options, self.progress = case, out, options, progress
        self.outcome = CaseOutcome(case.folder, out)
        self.memory = Memory(out, case.subject)
        self.chain = Chain(case, out)

    def all(self) -> CaseOutcome:
        from limbcli.stages.report import report
        from limbcli.stages.segment import edited_labels, segment

        raw, images = self.case.raw, self.case.imaging
        paths = [p for p in (images.mri, images.labels, images.skin, *images.bones) if p]
        edited = [path for path in [edited_labels(self.out)] if path]
        wishes = self._asked("segment", None, without=("seeds", "threshold", "limb") if edited else ())
        key = key_of(code_hash(), raw.get("imaging"), raw["subject"], *paths, *edited, *_parts(wishes))
        done = self._stage("segment", None, key, lambda: segment(self.case, **self._common(), **wishes))
        keys = [self._site(site.name, key) for site in self.case.sites] if done else []
        if not done:
            for site in self.case.sites:
                self._skip(("mesh", "build-feb", "run", "fit"), site.name, because="segment")
        made = [self._extra(each, keys) for each in extras(self.case, self.out, progress=self.progress)]
        keys += [*made, *(sha256(path) for path in shown_only(self.case, self.out))]
        everything = key_of(key, *keys, raw, [str(each.error) for each in self.outcome.failures])
        if self._stage("report", None, everything, lambda: report(self.case, **self._common())):
            self.outcome.report = stage_folder(self.out, "report") / "report.html"
        return self.outcome

    def _extra(self, extra: Extra, keys: Sequence[str]) -> str:
        """A fit that was made on demand: fresh, or made again; a hash of what it is now, for the report."""
        folder = stage_folder(self.out, extra.stage, extra.site)
        by_site = zip(self.case.sites, keys, strict=False)
        key = key_of(extra.stage, *(each for site, each in by_site if site.name in extra.sites))
        sound = extra.is_current and not (folder / ERROR_FILE).exists()
        if sound and self.memory.made_since(extra.stage, extra.site):
            self.memory.remember(extra.stage, extra.site, key)
        failed = [each for each in self.outcome.failures if each.site in (None, *extra.sites)]
        if failed:
            self._skip((extra.stage,), extra.site, because=failed[0].stage, keep_result=True)
        else:
            self._stage(extra.stage, extra.site, key, extra.redo, keep_result=True)
        return sha256(folder)

    def _asked(self, stage: str, site: str | None, *, without: Sequence[str] = ()) -> dict[str, Any]:
        """Options of the stage's last call by hand; kept, and said.

        without : those that something stronger stands in for (the batch's own option)
        """
        asked = {} if self.options.defaults else self.memory.asked(stage, site)
        self.memory.keep_asked(stage, site, asked)
        asked = {key: value for key, value in asked.items() if key not in without}
        if asked:
            label, words = f"{stage} {site}" if site else stage, in_words(asked)
            self.outcome.kept[label] = words
            self.progress.event(
                "note", text=f"{label}: as it was called by hand, with {words} (--defaults: without)"
            )
        return asked

    def _common(self) -> dict[str, Any]:
        return {"out": self.out, "progress": self.progress}

    def _site(self, name: str, key: str) -> str:
        """The stages of one site; returns the key of the last, for the report."""
        from limbcli.stages.build_feb import TissueOptions, build_feb
        from limbcli.stages.fit import FitOptions, fit
        from limbcli.stages.mesh import mesh
        from limbcli.stages.run import RunOptions, run

        raw, options, common = self.case.raw, self.options, self._common()
        site = self.case.site(name)
        meshed = self._asked("mesh", name, without=("element",) if options.element else ())
        own = ("templates",) if options.templates else ()
        tissue, ran, fitted = (self._asked(each, name, without=own) for each in ("build-feb", "run", "fit"))
        if options.element:
            meshed["element"] = options.element
        templates = options.templates or _path(tissue.get("templates"))
        fit_options = replace(options_of(FitOptions, fitted), **({"templates": templates} if own else {}))
        table = next(each for each in raw["site"] if each["name"] == name)
        solver: dict[str, Any] = {"solver": options.solver, "febio": options.febio}
        measured = [path for path in (site.levels, site.trace, site.swe_maps) if path]
        study = stage_folder(self.out, "mesh-study", name) / "mesh-study.json"
        steps: list[tuple[str, tuple[object, ...], Callable[[], object]]] = [
            (
                "mesh",
                (raw["probe"], raw.get("model"), table, *_parts(meshed)),
                lambda: mesh(self.case, sites=[name], **meshed, **common),
            ),
            (
                "build-feb",
                (*measured, *([templates] if templates else []), *_parts(tissue)),
                lambda: build_feb(
                    self.case, sites=[name], options=options_of(TissueOptions, tissue), templates=templates,
                    **common,
                ),
            ),
            (
                "run", (*solver.items(), *_parts(ran)),
                lambda: run(self.case, sites=[name], options=options_of(RunOptions, ran), **solver, **common),
            ),
            (
                "fit", (*([study] if study.is_file() else []), *_parts(fitted)),
                lambda: fit(self.case, sites=[name], options=fit_options, **solver, **common),
            ),
        ]  # fmt: skip
        for k, (stage, parts, work) in enumerate(steps):
            key = key_of(key, *parts)
            if stage == "fit" and self._fit_is_there(name):
                self.memory.remember(stage, name, key)
            if not self._stage(stage, name, key, work):
                self._skip([each for each, _, _ in steps[k + 1 :]], name, because=stage)
                break
        return key

    def _fit_is_there(self, site: str) -> bool:
        """Whether a fit made by hand is what this batch would make."""
        made = self.memory.made_since("fit", site) and not self.options.defaults
        return made and made_by_hand(self.case, self.out, site, solver=self.options.solver)

    def _skip(
        self, stages: Sequence[str], site: str | None, *, because: str, keep_result: bool = False
    ) -> None:
        """Stages that cannot run say so, and results of an earlier run no longer count."""
        for stage in stages:
            error = CaseError(
                f"`{stage}` was not run, because `{because}` failed",
                where=f"site {site}" if site else str(self.case.folder),
                fix=f"mend what `{because}` says, then run the batch again",
            )
            keep_error(self.out, stage, site, error, keep_result=keep_result)

    def _stage(
        self, stage: str, site: str | None, key: str, work: Callable[[], object], *, keep_result: bool = False
    ) -> bool:
        """Run a stage unless it is fresh; False if it failed (`keep_result`: the one before stays)."""
        label = f"{stage} {site}" if site else stage
        if not self.options.force and self.memory.is_fresh(stage, site, key) and self._holds(stage, site):
            self.outcome.fresh.append(label)
            self.progress.event("note", text=f"{label}: nothing changed")
            return True
        self.progress.event("stage", name=stage, site=site)
        try:
            self._pass_on(work())
        except LimbError as raised:
            error = pasted(raised, self.case.folder, self.out)
            self.outcome.failures.append(Failure(stage, site, error))
            keep_error(self.out, stage, site, error, keep_result=keep_result)
            self.progress.event("note", text=f"{type(error).__name__}: {error.what}")
            return False
        self.memory.remember(stage, site, key)
        self.outcome.ran.append(label)
        return True

    def _holds(self, stage: str, site: str | None) -> bool:
        """Whether all that a result was made from is as it was (also what no key sees, such as a place)."""
        try:
            return self.chain.broken(read_result(self.out, stage, site=site)) is None
        except CaseError:
            return False

    def _pass_on(self, results: object) -> None:
        several: Sequence[object] = results if isinstance(results, Sequence) else [results]
        for each in several:
            if isinstance(each, StageResult):
                for line in (*each.summary, *(f"warning: {text}" for text in each.warnings)):
                    self.progress.event("note", text=line)


def _parts(asked: Mapping[str, Any]) -> tuple[object, ...]:
    """What a key sees of options that were asked for."""
    return (sorted(asked.items()),) if asked else ()


def _path(text: str | None) -> Path | None:
    return Path(text) if text else None


def keep_error(
    out: Path, stage: str, site: str | None, error: LimbError, *, keep_result: bool = False
) -> None:
    """Leave a stage's failure where the report finds it; the stale result no longer counts.

    keep_result : it stays beside the failure, to tell another time how to make it again
    """
    folder = stage_folder(out, stage, site)
    if not keep_result:
        (folder / f"{stage}.json").unlink(missing_ok=True)
    with atomic_file(folder / ERROR_FILE) as path:
        path.write_text(json.dumps(error_json(error), indent=1), encoding="utf-8")


def error_json(error: LimbError) -> dict[str, Any]:
    return {
        "error": type(error).__name__,
        "exit_code": error.exit_code,
        "what": error.what,
        "where": error.where,
        "fix": error.fix,
        "facts": json.loads(json.dumps(plain(error.facts), default=str)),
    }
