"""`limbcli diagnose CASE`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.choices import MEASURED, effect_names, such_as
from limbcli.cli.options import (
    CaseArg,
    FebioOpt,
    JsonOpt,
    NoWaitOpt,
    OutOpt,
    QuietOpt,
    SiteOpt,
    SolverOpt,
    TemplatesOpt,
    VerboseOpt,
)
from limbcli.cli.terminal import emit, terminal
from limbcli.output_lock import one_writer


def command(
    case: CaseArg,
    out: OutOpt = None,
    site: SiteOpt = None,
    solver: SolverOpt = "auto",
    febio: FebioOpt = None,
    effects: Annotated[
        list[str] | None,
        typer.Option(
            "--effects",
            metavar="NAME",
            help="Try only this effect (may be repeated), and that of --effect-file; default: all.",
            **such_as(effect_names),
        ),
    ] = None,
    effect_file: Annotated[
        Path | None,
        typer.Option("--effect-file", metavar="FILE", help="An effect of your own.", show_default=False),
    ] = None,
    max_effects: Annotated[
        int, typer.Option(min=1, max=2, help="Maximum number of effects missing together.")
    ] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Of all random draws.")] = 7,
    size_mm: Annotated[
        float | None,
        typer.Option(
            "--size-mm",
            min=1,
            max=20,
            help="Working mesh under the probe; default: 5, less where tissue is thin.",
        ),
    ] = None,
    far_size_mm: Annotated[
        float, typer.Option("--far-size-mm", min=2, max=50, help="Working mesh far from it.")
    ] = 14.0,
    interventions: Annotated[
        bool, typer.Option(help="Try crop and contact first (a few more simulations).")
    ] = True,
    separate: Annotated[
        bool, typer.Option("--separate", help="Diagnose each site separately, also those that share a place.")
    ] = False,
    measured: Annotated[
        list[str] | None,
        typer.Option(
            "--measured",
            metavar="KEY=VALUE",
            help="A separately measured number: tare_n, force_gain, first_depth_mm, rate_ratio.",
            **such_as(lambda: [f"{each}=" for each in MEASURED]),
        ),
    ] = None,
    templates: TemplatesOpt = None,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Find where model and measurement disagree, what is missing, and what to measure next."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.diagnose import DiagnoseOptions, diagnose

    options = DiagnoseOptions(
        effects=tuple(effects or ()), effect_file=effect_file, max_effects=max_effects, seed=seed,
        size=size_mm, far_size=far_size_mm, templates=templates, interventions=interventions,
        separate=separate, measured=_numbers(measured or []), solver=solver, febio=febio,
    )  # fmt: skip
    progress = terminal(quiet=quiet, verbose=verbose)
    opened, target = Case.open(case), out or default_out(case)
    with one_writer(target, wait=not no_wait, progress=progress):
        results = diagnose(opened, out=target, sites=site, options=options, progress=progress)
    emit(results, as_json=json)


def _numbers(given: list[str]) -> dict[str, float]:
    """Parse arguments such as "tare_n=0.4" into numbers by name."""
    from limbcli.errors import CaseError

    found = {}
    for text in given:
        key, _, value = text.partition("=")
        try:
            found[key.strip()] = float(value)
        except ValueError:
            raise CaseError(
                f"{text!r} is not KEY=NUMBER", where="--measured", fix="for example --measured tare_n=0.4"
            ) from None
    return found
