"""`limbcli phantom DIR`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from limbcli.cli.options import JsonOpt, QuietOpt, VerboseOpt
from limbcli.cli.synth_options import with_synth_options
from limbcli.cli.terminal import emit, terminal

FolderArg = Annotated[Path, typer.Argument(metavar="DIR", help="Case folder to create.", show_default=False)]
SeedOpt = Annotated[
    int, typer.Option("--seed", min=0, help="Random seed; another seed gives another subject.")
]
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


@with_synth_options
def command(
    folder: FolderArg,
    seed: SeedOpt = 7,
    force: ForceOpt = False,
    name: NameOpt = "phantom",
    site: PlaceOpt = None,
    no_measurement: BareOpt = False,
    plan: Any = None,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Create a synthetic subject with known truth: MRI, measurements, truth."""
    from limbcli.stages.phantom import USUAL_SITES, PhantomOptions, phantom, refuse_unheard

    if no_measurement:
        refuse_unheard(plan)
    options = PhantomOptions(
        seed=seed,
        subject_id=name,
        site_names=tuple(site) if site else USUAL_SITES,
        element=plan.element or "tet10",
        synth=None if no_measurement else replace(plan, seed=seed),
    )
    progress = terminal(quiet=quiet, verbose=verbose)
    emit(phantom(folder, options=options, force=force, progress=progress), as_json=json)
