"""`limbcli measure CASE`."""

from __future__ import annotations

from typing import Annotated

import typer

from limbcli.cli.options import CaseArg, JsonOpt, NoWaitOpt, OutOpt, QuietOpt, SiteOpt, VerboseOpt
from limbcli.cli.terminal import emit, terminal
from limbcli.output_lock import one_writer

WriteOpt = Annotated[
    bool, typer.Option("--write", help="Also write levels.csv to the path given in case.toml (if absent).")
]


def command(
    case: CaseArg,
    out: OutOpt = None,
    site: SiteOpt = None,
    write: WriteOpt = False,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Convert the load-cell record, B-mode and elastography images to the rows of levels.csv."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.measure import measure

    progress = terminal(quiet=quiet, verbose=verbose)
    target = out or default_out(case)
    opened = Case.open(case)
    with one_writer(target, wait=not no_wait, progress=progress):
        results = measure(opened, out=target, sites=site, write=write, progress=progress)
    emit(results, as_json=json)
