"""`limbcli batch CASE [CASE ...]`."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from limbcli.cli.options import (
    FebioOpt,
    JsonOpt,
    NoWaitOpt,
    OutOpt,
    QuietOpt,
    SolverOpt,
    TemplatesOpt,
    VerboseOpt,
)
from limbcli.cli.terminal import emit_json, terminal
from limbcli.writing import one_writer

if TYPE_CHECKING:
    from limbcli.progress import Progress
    from limbcli.stages.batch import BatchOptions

CasesArg = Annotated[list[Path], typer.Argument(metavar="CASE...", help="Case folders.", show_default=False)]
ElementOpt = Annotated[
    str | None, typer.Option("--element", help="tet10 | tet4; default: the case's own.", show_default=False)
]
ForceOpt = Annotated[bool, typer.Option("--force", help="Redo every stage, also where nothing changed.")]
DefaultsOpt = Annotated[
    bool, typer.Option("--defaults", help="Forget the options that stages were called with by hand.")
]
ExpectOpt = Annotated[bool, typer.Option("--expect", help="Compare with each case's expected.toml.")]


def command(
    cases: CasesArg,
    out: OutOpt = None,
    element: ElementOpt = None,
    solver: SolverOpt = "auto",
    febio: FebioOpt = None,
    templates: TemplatesOpt = None,
    force: ForceOpt = False,
    defaults: DefaultsOpt = False,
    expect: ExpectOpt = False,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """All stages of one or more cases, from images to report; redoes only what changed.

    A stage that was called by hand with options is called with them again, and that is said.
    With one CASE, --out is its output folder; with several, the folder that holds
    one output folder a case, and an index page. The last line printed is the report
    (of several cases, the index).
    """
    from limbcli.config import default_out
    from limbcli.stages.batch import BatchOptions

    options = BatchOptions(
        element=element, solver=solver, febio=febio, templates=templates, force=force, defaults=defaults
    )
    progress = terminal(quiet=quiet, verbose=verbose)
    entries = []
    for case in cases:
        target = default_out(case) if out is None else out if len(cases) == 1 else out / case.resolve().name
        entries.append(_one(case, target, options, progress, wait=not no_wait, expect=expect, as_json=json))
    if json:
        emit_json([each for each, _ in entries])
    if len(cases) > 1:
        _index(out or default_out(cases[0]).parent, progress, as_json=json)
    failed = [(entry["case"], code) for entry, code in entries if code]
    if failed:
        names = ", ".join(str(name) for name, _ in failed)
        print(f"{len(failed)} of {len(entries)} cases failed: {names}", file=sys.stderr)
        raise typer.Exit(max(code for _, code in failed))


def _index(folder: Path, progress: Progress, *, as_json: bool) -> None:
    """The page that lists all; where no case left anything to list, that is said and is no failure more."""
    from limbcli.cli.app import report_error
    from limbcli.errors import LimbError
    from limbcli.stages.report_index import report_index

    try:
        index = report_index(folder, progress=progress)
    except LimbError as error:
        report_error(error, as_json=False)
        return
    if not as_json:
        print(index.page)


def _one(
    case: Path,
    target: Path,
    options: BatchOptions,
    progress: Progress,
    *,
    wait: bool,
    expect: bool,
    as_json: bool,
) -> tuple[dict[str, Any], int]:
    """One case: its JSON entry and its exit code; its error is shown, not raised."""
    from limbcli.cli.app import report_error
    from limbcli.cli.last_net import unforeseen
    from limbcli.errors import FitError, LimbError
    from limbcli.faults import in_words
    from limbcli.stages.batch import batch
    from limbcli.stages.expect import compare

    progress.event("stage", name=f"case {case}")
    try:
        turn = one_writer(target, wait=wait, progress=progress) if case.is_dir() else nullcontext()
        with turn:
            outcome = batch(case, out=target, options=options, progress=progress)
        comparisons = compare(case, target) if expect else []
    except LimbError as error:
        report_error(error, as_json=False)
        return {"case": str(case), "out": str(target), "error": error.what}, error.exit_code
    except Exception as error:  # one case's fault never stops the others
        known = in_words(error, target) if isinstance(error, OSError) else None
        told = known or unforeseen(error, target if target.is_dir() else None)
        report_error(told, as_json=False)
        return {"case": str(case), "out": str(target), "error": told.what}, told.exit_code
    code = max((each.error.exit_code for each in outcome.failures), default=0)
    for failure in outcome.failures:
        report_error(failure.error, as_json=False)
    if not all(each.holds for each in comparisons):
        code = code or FitError.exit_code
    if not as_json:
        for each in comparisons:
            print(each)
        if outcome.report:
            print(outcome.report)
    entry = outcome.to_json()
    if expect:
        entry["expected"] = [{**vars(each), "expected": each.expected} for each in comparisons]
    return entry, code
