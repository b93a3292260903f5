"""Arguments and options shared by several subcommands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from limbcli.mesh_bounds import ELEMENTS

CaseArg = Annotated[
    Path, typer.Argument(metavar="CASE", help="Case folder (containing case.toml).", show_default=False)
]
OutOpt = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="DIR", help="Output folder; default: out/<name of CASE>.", show_default=False
    ),
]
SiteOpt = Annotated[
    list[str] | None,
    typer.Option("--site", "-s", metavar="NAME", help="Only this site (may be repeated); default: all."),
]
NoWaitOpt = Annotated[
    bool,
    typer.Option("--no-wait", help="Fail immediately if another limbcli is writing into the output folder."),
]
JsonOpt = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
QuietOpt = Annotated[bool, typer.Option("--quiet", "-q", help="No progress; only the result.")]
VerboseOpt = Annotated[
    int, typer.Option("--verbose", "-v", count=True, help="More output; twice: all of it.")
]


def one_of_the_elements(value: str) -> str:
    """The name of an element, refused before any file is read."""
    if value not in ELEMENTS:
        raise typer.BadParameter(f"{value!r} is not one of {', '.join(ELEMENTS)}")
    return value


ElementOpt = Annotated[
    str | None,
    typer.Option(
        "--element",
        metavar="|".join(ELEMENTS),
        parser=one_of_the_elements,
        autocompletion=lambda: list(ELEMENTS),
        help="Elements of the tissue's mesh; default: the case's.",
        show_default=False,
    ),
]
SolverOpt = Annotated[str, typer.Option("--solver", help="auto | febio | reference")]
FebioOpt = Annotated[
    Path | None, typer.Option("--febio", metavar="FILE", help="The FEBio binary.", show_default=False)
]
TemplatesOpt = Annotated[
    Path | None,
    typer.Option(
        "--templates",
        metavar="DIR",
        help="Folder of your own templates, which take precedence over limbcli's.",
    ),
]
CKpaOpt = Annotated[
    float | None,
    typer.Option(
        "--c-kpa", help="c = 2 mu, entered by hand; default: from SWE at level 0.", show_default=False
    ),
]
