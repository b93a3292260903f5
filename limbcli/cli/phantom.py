"""`limbcli phantom DIR`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.options import JsonOpt, QuietOpt, VerboseOpt
from limbcli.cli.synth_options import (
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

FolderArg = Annotated[Path, typer.Argument(metavar="DIR", help="Case folder to make.", show_default=False)]
SeedOpt = Annotated[int, typer.Option("--seed", min=0, help="Another seed is another subject.")]
ForceOpt = Annotated[bool, typer.Option("--force", help="Replace DIR if it is a synthetic subject.")]
NameOpt = Annotated[str, typer.Option("--id", metavar="NAME", help="The subject's id.")]
PlaceOpt = Annotated[
    list[str] | None,
    typer.Option(
        "--site",
        "-s",
        metavar="NAME",
        help="p1: at the back, by marker, across; p2: over the fibula, by position, along."
        " May be repeated; default: p1.",
        show_default=False,
    ),
]
BareOpt = Annotated[bool, typer.Option("--no-measurement", help="Geometry only: levels.csv stays empty.")]


def command(
    folder: FolderArg,
    seed: SeedOpt = 7,
    force: ForceOpt = False,
    name: NameOpt = "phantom",
    site: PlaceOpt = None,
    no_measurement: BareOpt = False,
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
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """A synthetic subject whose truth is known: MRI, measurements, truth."""
    from limbcli.stages.phantom import USUAL_SITES, PhantomOptions, phantom
    from limbcli.stages.simulated_subjects.hidden_effects import hide
    from limbcli.stages.simulated_subjects.indent import KnownTissue
    from limbcli.stages.synth import LoadingProtocol, SynthOptions

    plan = SynthOptions(
        tissue=KnownTissue(c_kpa=c_kpa, f_kappa=f_kappa, m=m),
        seed=seed,
        noise=noise,
        element=element,
        size=size_mm,
        far_size=far_size_mm,
        margin=margin_mm,
        same_mesh=same_mesh,
        hidden=tuple(hide(each) for each in effect or ()),
        protocol=LoadingProtocol(step=step_n, max_force=max_force_n, max_strain=max_strain),
    )
    options = PhantomOptions(
        seed=seed,
        subject_id=name,
        site_names=tuple(site) if site else USUAL_SITES,
        element=element or "tet10",
        synth=None if no_measurement else plan,
    )
    progress = terminal(quiet=quiet, verbose=verbose)
    emit(phantom(folder, options=options, force=force, progress=progress), as_json=json)
