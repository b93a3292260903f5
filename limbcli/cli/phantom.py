"""`limbcli phantom DIR`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.options import JsonOpt, QuietOpt, SiteOpt, VerboseOpt
from limbcli.cli.terminal import emit, terminal

FolderArg = Annotated[Path, typer.Argument(metavar="DIR", help="Case folder to make.", show_default=False)]
SeedOpt = Annotated[int, typer.Option("--seed", min=0, help="Another seed is another subject.")]
ForceOpt = Annotated[bool, typer.Option("--force", help="Replace DIR if it is a synthetic subject.")]
NameOpt = Annotated[str, typer.Option("--id", metavar="NAME", help="The subject's id.")]
BareOpt = Annotated[bool, typer.Option("--no-measurement", help="Geometry only: levels.csv stays empty.")]


def command(
    folder: FolderArg,
    seed: SeedOpt = 7,
    force: ForceOpt = False,
    name: NameOpt = "phantom",
    site: SiteOpt = None,
    no_measurement: BareOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """A synthetic subject whose truth is known: MRI, measurements, truth.toml."""
    from limbcli.phantom.subject import PLACES
    from limbcli.stages.phantom import PhantomOptions, phantom

    options = PhantomOptions(
        seed=seed,
        subject_id=name,
        site_names=tuple(site) if site else tuple(each.name for each in PLACES),
        measured=not no_measurement,
    )
    progress = terminal(quiet=quiet, verbose=verbose)
    emit(phantom(folder, options=options, force=force, progress=progress), as_json=json)
