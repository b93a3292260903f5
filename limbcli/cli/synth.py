"""`limbcli synth CASE --out-case DIR`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.options import CaseArg, JsonOpt, NoWaitOpt, OutOpt, QuietOpt, SiteOpt, VerboseOpt
from limbcli.cli.synth_options import (
    ContactPenaltyOpt,
    CStiffOpt,
    EffectOpt,
    FKappaOpt,
    MaxForceOpt,
    MaxStrainOpt,
    MOpt,
    NoiseOpt,
    SameMeshOpt,
    StepOpt,
    SynthElementOpt,
    SynthFarSizeOpt,
    SynthMarginOpt,
    SynthSizeOpt,
)
from limbcli.cli.terminal import emit, terminal
from limbcli.writing import one_writer

OutCaseOpt = Annotated[
    Path, typer.Option("--out-case", metavar="DIR", help="Case folder to make.", show_default=False)
]
SeedOpt = Annotated[int, typer.Option("--seed", min=0, help="Of the measurement noise.")]
LayersOpt = Annotated[
    bool,
    typer.Option("--with-layers", help="Read skin, fat and muscle too, as thick as the geometry tells them."),
]
ForceOpt = Annotated[bool, typer.Option("--force", help="Replace DIR if synth made it.")]


def command(
    case: CaseArg,
    out_case: OutCaseOpt,
    out: OutOpt = None,
    site: SiteOpt = None,
    seed: SeedOpt = 7,
    force: ForceOpt = False,
    c_kpa: CStiffOpt = 8.0,
    f_kappa: FKappaOpt = 80.0,
    m: MOpt = 6.0,
    effect: EffectOpt = None,
    noise: NoiseOpt = 1.0,
    step_n: StepOpt = 2.0,
    max_force_n: MaxForceOpt = 12.0,
    max_strain: MaxStrainOpt = 0.45,
    element: SynthElementOpt = None,
    size_mm: SynthSizeOpt = 4.0,
    far_size_mm: SynthFarSizeOpt = 12.0,
    margin_mm: SynthMarginOpt = None,
    same_mesh: SameMeshOpt = False,
    with_layers: LayersOpt = False,
    contact_penalty: ContactPenaltyOpt = None,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Measurements with known parameters on the geometry of an existing case, as a new case."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.simulated_subjects.hidden_effects import hide
    from limbcli.stages.simulated_subjects.indent import KnownTissue
    from limbcli.stages.synth import LoadingProtocol, SynthOptions, synth

    options = SynthOptions(
        tissue=KnownTissue(c_kpa=c_kpa, f_kappa=f_kappa, m=m),
        seed=seed,
        noise=noise,
        element=element,
        size=size_mm,
        far_size=far_size_mm,
        margin=margin_mm,
        same_mesh=same_mesh,
        contact_penalty=contact_penalty,
        hidden=tuple(hide(each) for each in effect or ()),
        layers=with_layers,
        protocol=LoadingProtocol(step=step_n, max_force=max_force_n, max_strain=max_strain),
    )
    opened, target = Case.open(case), out or default_out(case)
    progress = terminal(quiet=quiet, verbose=verbose)
    with one_writer(target, wait=not no_wait, progress=progress):
        result = synth(
            opened, out=target, out_case=out_case, sites=site, options=options, force=force, progress=progress
        )
    emit(result, as_json=json)
