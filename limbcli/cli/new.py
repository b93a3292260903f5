"""`limbcli new DIR`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.cli.options import JsonOpt, QuietOpt, VerboseOpt
from limbcli.cli.terminal import emit

FolderArg = Annotated[
    Path, typer.Argument(metavar="DIR", help="Case folder to create; absent or empty.", show_default=False)
]
PlaceOpt = Annotated[
    list[str] | None,
    typer.Option(
        "--site",
        "-s",
        metavar="NAME",
        help="Name of a measured site (may be repeated); default: p1.",
        show_default=False,
    ),
]


def command(
    folder: FolderArg,
    site: PlaceOpt = None,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Create a case folder to fill in: commented case.toml, levels.csv, and a README that says where data go.

    Existing files are never changed: a folder that is not empty is rejected.
    """
    from limbcli.stages.new import new

    emit(new(folder, sites=tuple(site) if site else ("p1",)), as_json=json)
