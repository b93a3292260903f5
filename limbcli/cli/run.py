"""`limbcli run CASE` or `limbcli run FILE.feb`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.options import FebioOpt, JsonOpt, NoWaitOpt, OutOpt, QuietOpt, SiteOpt, SolverOpt, VerboseOpt
from limbcli.cli.terminal import emit, terminal
from limbcli.errors import CaseError
from limbcli.output_lock import one_writer

CaseOrFileArg = Annotated[
    Path | None,
    typer.Argument(
        metavar="CASE|FILE.feb", help="Case folder, or a FEBio model of your own.", show_default=False
    ),
]


def command(
    case: CaseOrFileArg = None,
    feb: Annotated[
        Path | None, typer.Option("--feb", metavar="FILE", help="A FEBio model instead of a case.")
    ] = None,
    out: OutOpt = None,
    site: SiteOpt = None,
    solver: SolverOpt = "auto",
    febio: FebioOpt = None,
    time_limit_s: Annotated[
        float | None,
        typer.Option(
            "--time-limit-s",
            min=0,
            help="Time limit of each simulation; default: by the model's size.",
            show_default=False,
        ),
    ] = None,
    vtu: Annotated[bool, typer.Option("--vtu", help="Also a time series for ParaView.")] = False,
    keep_plot: Annotated[
        bool, typer.Option("--keep-plot", help="Keep FEBio's plot file (model.xplt), for FEBio Studio.")
    ] = False,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Simulate the indentation with FEBio, or with the bundled reference solver."""
    from limbcli.config import default_out
    from limbcli.stages.run import RunOptions, model_name, run, run_file

    options = RunOptions(time_limit_s=time_limit_s, vtu=vtu, keep_plot=keep_plot)
    progress = terminal(quiet=quiet, verbose=verbose)
    file = feb or (case if case is not None and is_model_file(case) else None)
    if file is not None and (case is None or file == case):
        if site:
            raise CaseError(
                "a model file has no sites", where="--site", fix="omit --site, or give a case folder"
            )
        target = out or default_out(Path(model_name(file)))
        with one_writer(target, wait=not no_wait, progress=progress):
            one = run_file(file, out=target, solver=solver, febio=febio, options=options, progress=progress)
        emit(one, as_json=json)
        return
    if case is None or feb is not None:
        raise CaseError(
            "give either a case folder or one model file",
            where="limbcli run",
            fix="limbcli run CASE, or limbcli run FILE.feb",
        )
    from limbcli.case import Case

    opened, target = Case.open(case), out or default_out(case)
    with one_writer(target, wait=not no_wait, progress=progress):
        results = run(
            opened, out=target, sites=site, solver=solver, febio=febio, options=options, progress=progress
        )
    emit(results, as_json=json)


def is_model_file(path: Path) -> bool:
    """
    >>> is_model_file(Path("model.feb.gz")), is_model_file(Path("cases/phantom"))
    (True, False)
    """
    return path.name.endswith((".feb", ".feb.gz"))
