"""`limbcli build-feb CASE`."""

from __future__ import annotations

from typing import Annotated

import typer

from limbcli.cli.choices import such_as
from limbcli.cli.options import (
    CaseArg,
    CKpaOpt,
    JsonOpt,
    NoWaitOpt,
    OutOpt,
    QuietOpt,
    SiteOpt,
    TemplatesOpt,
    VerboseOpt,
)
from limbcli.cli.terminal import emit, terminal
from limbcli.output_lock import one_writer


def command(
    case: CaseArg,
    out: OutOpt = None,
    site: SiteOpt = None,
    c_kpa: CKpaOpt = None,
    f_kappa: Annotated[float, typer.Option("--f-kappa", min=0.01, max=1000, help="kappa' / c.")] = 100.0,
    m: Annotated[float, typer.Option("--m", min=1, max=100, help="Exponent of the law.")] = 2.0,
    layer: Annotated[
        list[str] | None,
        typer.Option(
            "--layer",
            metavar="NAME:KEY=VALUE,...",
            help="Law of a layer, such as fat:c_kpa=2,f_kappa=100,m=2 or skin:law=neo_hooke,c_kpa=40; "
            "default: the case's, else assumed values. May be repeated.",
            **such_as(lambda: ["fat:", "skin:"]),
        ),
    ] = None,
    contact_penalty: Annotated[
        float | None,
        typer.Option(
            "--contact-penalty",
            min=1,
            max=1000,
            show_default=False,
            help="Times the skin's stiffness at rest; default 20, with which FEBio converges. More where fit "
            "warns that the probe sinks in.",
        ),
    ] = None,
    abaqus: Annotated[
        bool, typer.Option("--abaqus", help="Also model.inp, the same model for Abaqus in its nearest laws.")
    ] = False,
    templates: TemplatesOpt = None,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Write the mesh and the measurement as a FEBio model, using templates."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.build_feb import TissueOptions, build_feb
    from limbcli.stages.site_model.site_layers import parse_law

    opened, target = Case.open(case), out or default_out(case)
    progress = terminal(quiet=quiet, verbose=verbose)
    options = TissueOptions(
        c_kpa=c_kpa,
        f_kappa=f_kappa,
        m=m,
        layers=dict(map(parse_law, layer or [])),
        contact_penalty=contact_penalty,
        abaqus=abaqus,
    )
    with one_writer(target, wait=not no_wait, progress=progress):
        results = build_feb(
            opened, out=target, sites=site, options=options, templates=templates, progress=progress
        )
    emit(results, as_json=json)
