"""`limbcli report CASE`, `limbcli report --index DIR`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.options import JsonOpt, NoWaitOpt, OutOpt, QuietOpt, TemplatesOpt, VerboseOpt
from limbcli.cli.say import say
from limbcli.cli.terminal import emit, emit_json, terminal
from limbcli.output_lock import one_writer
from limbcli.progress import Progress

OptionalCaseArg = Annotated[
    Path | None,
    typer.Argument(metavar="CASE", help="Case folder (containing case.toml).", show_default=False),
]
IndexOpt = Annotated[
    Path | None,
    typer.Option(
        "--index",
        metavar="DIR",
        help="Instead of one subject's page: a page that lists all subjects whose results lie in DIR.",
        show_default=False,
    ),
]
OpenOpt = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]


def command(
    case: OptionalCaseArg = None,
    out: OutOpt = None,
    index: IndexOpt = None,
    open_page: OpenOpt = False,
    templates: TemplatesOpt = None,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Write one self-contained page of the stages' results, or an index of many subjects."""
    if (case is None) == (index is None):
        raise typer.BadParameter("give either CASE or --index DIR")
    if index is not None and (out is not None or no_wait):
        raise typer.BadParameter("the index is written into DIR itself: omit --out and --no-wait")
    progress = terminal(quiet=quiet, verbose=verbose)
    if index is not None:
        page = _index(index, templates, progress, as_json=json)
    else:
        assert case is not None
        page = _report(case, out, templates, progress, wait=not no_wait, as_json=json)
    if open_page:
        typer.launch(str(page.resolve()))


def _report(
    case: Path, out: Path | None, templates: Path | None, progress: Progress, *, wait: bool, as_json: bool
) -> Path:
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.report import report

    opened, target = Case.open(case), out or default_out(case)
    with one_writer(target, wait=wait, progress=progress):
        result = report(opened, out=target, templates=templates, progress=progress)
    emit(result, as_json=as_json)
    return result.path("page")


def _index(folder: Path, templates: Path | None, progress: Progress, *, as_json: bool) -> Path:
    from limbcli.stages.report_pages.index import report_index

    result = report_index(folder, templates=templates, progress=progress)
    if as_json:
        emit_json(result.to_json())
    else:
        say(f"index: {result.page} ({result.n_subjects} subject{'s' if result.n_subjects != 1 else ''})")
    return result.page
