"""`limbcli report CASE`, `limbcli report --index DIR`."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Annotated

import typer

from limbcli.api.diagnosis import report
from limbcli.cli.output import say
from limbcli.cli.terminal import emit, emit_json
from limbcli.options import Option
from limbcli.progress import Progress


def report_case_or_index(
    case: Annotated[
        Path | None, Option("Case folder (containing case.toml).", metavar="CASE", kind=Path)
    ] = None,
    *,
    index: Annotated[
        Path | None,
        Option(
            "Instead of one subject's page: a page that lists all subjects whose results lie in DIR.",
            metavar="DIR",
            kind=Path,
            before="templates",
        ),
    ] = None,
    open_page: Annotated[
        bool, Option("Open the page in the browser.", flag="--open", before="templates")
    ] = False,
    out: Path | None,
    templates: Path | None,
    wait: bool,
    json: bool,
    progress: Progress,
) -> None:
    """Write one self-contained page of the stages' results, or an index of many subjects."""
    if (case is None) == (index is None):
        raise typer.BadParameter("give either CASE or --index DIR")
    if index is not None and (out is not None or not wait):
        raise typer.BadParameter("the index is written into DIR itself: omit --out and --no-wait")
    if index is not None:
        page = _index(index, templates, progress, as_json=json)
    else:
        result = inspect.unwrap(report)(case, out=out, templates=templates, wait=wait, progress=progress)
        emit(result, as_json=json)
        page = result.path("page")
    if open_page:
        typer.launch(str(page.resolve()))


def _index(folder: Path, templates: Path | None, progress: Progress, *, as_json: bool) -> Path:
    from limbcli.stages.report_pages.index import report_index

    result = report_index(folder, templates=templates, progress=progress)
    if as_json:
        emit_json(result.to_json())
    else:
        say(f"index: {result.page} ({result.n_subjects} subject{'s' if result.n_subjects != 1 else ''})")
    return result.page
