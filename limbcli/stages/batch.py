"""batch: every stage of every case, in order, redoing only what changed.

One site's or one case's failure never stops the others: it is kept as
`error.json` in the stage's folder, the report shows it, and the batch says so at
its end.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from limbcli.case import Case
from limbcli.errors import CaseError, LimbError
from limbcli.files import atomic_file, sha256
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, plain, stage_folder
from limbcli.stages.extras import Extra, extras, shown_only
from limbcli.stages.freshness import Memory, code_hash, key_of

ERROR_FILE = "error.json"


@dataclass(frozen=True)
class BatchOptions:
    """What the stages are told: `element` None is the case's own; `force` redoes everything."""

    element: str | None = None
    solver: str = "auto"
    febio: Path | None = None
    templates: Path | None = None
    force: bool = False


@dataclass(frozen=True)
class Failure:
    stage: str
    site: str | None
    error: LimbError


@dataclass
class CaseOutcome:
    """How one case went: what ran, what was fresh, what failed, and its report."""

    case: Path
    out: Path
    ran: list[str] = field(default_factory=list)
    fresh: list[str] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    report: Path | None = None

    def to_json(self) -> dict[str, Any]:
        return {
            "case": str(self.case),
            "out": str(self.out),
            "ran": self.ran,
            "fresh": self.fresh,
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
        self.memory = Memory(out)

    def all(self) -> CaseOutcome:
        from limbcli.stages.report import report
        from limbcli.stages.segment import edited_labels, segment

        raw, images = self.case.raw, self.case.imaging
        paths = [p for p in (images.mri, images.labels, images.skin, *images.bones) if p]
        edited = [path for path in [edited_labels(self.out)] if path]
        key = key_of(code_hash(), raw.get("imaging"), raw["subject"], *paths, *edited)
        done = self._stage("segment", None, key, lambda: segment(self.case, **self._common()))
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

    def _common(self) -> dict[str, Any]:
        return {"out": self.out, "progress": self.progress}

    def _site(self, name: str, key: str) -> str:
        """The stages of one site; returns the key of the last, for the report."""
        from limbcli.stages.build_feb import build_feb
        from limbcli.stages.fit import fit
        from limbcli.stages.mesh import mesh
        from limbcli.stages.run import run

        raw, options, common = self.case.raw, self.options, self._common()
        site = self.case.site(name)
        table = next(each for each in raw["site"] if each["name"] == name)
        solver: dict[str, Any] = {"solver": options.solver, "febio": options.febio}
        measured = [path for path in (site.levels, site.trace, site.swe_maps) if path]
        templates = [options.templates] if options.templates else []
        steps: list[tuple[str, tuple[object, ...], Callable[[], object]]] = [
            (
                "mesh",
                (raw["probe"], raw.get("model"), table, options.element),
                lambda: mesh(self.case, sites=[name], element=options.element, **common),
            ),
            (
                "build-feb",
                (*measured, *templates),
                lambda: build_feb(self.case, sites=[name], templates=options.templates, **common),
            ),
            ("run", tuple(solver.items()), lambda: run(self.case, sites=[name], **solver, **common)),
            ("fit", (), lambda: fit(self.case, sites=[name], **solver, **common)),
        ]
        for k, (stage, parts, work) in enumerate(steps):
            key = key_of(key, *parts)
            if not self._stage(stage, name, key, work):
                self._skip([each for each, _, _ in steps[k + 1 :]], name, because=stage)
                break
        return key

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
        if not self.options.force and self.memory.is_fresh(stage, site, key):
            self.outcome.fresh.append(label)
            self.progress.event("note", text=f"{label}: nothing changed")
            return True
        self.progress.event("stage", name=stage, site=site)
        try:
            self._pass_on(work())
        except LimbError as error:
            self.outcome.failures.append(Failure(stage, site, error))
            keep_error(self.out, stage, site, error, keep_result=keep_result)
            self.progress.event("note", text=f"{type(error).__name__}: {error.what}")
            return False
        self.memory.remember(stage, site, key)
        self.outcome.ran.append(label)
        return True

    def _pass_on(self, results: object) -> None:
        several: Sequence[object] = results if isinstance(results, Sequence) else [results]
        for each in several:
            if isinstance(each, StageResult):
                for line in (*each.summary, *(f"warning: {text}" for text in each.warnings)):
                    self.progress.event("note", text=line)


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
