"""`limbcli limb CASE`."""

from __future__ import annotations

from typing import Annotated

import typer

from limbcli.cli.options import (
    CaseArg,
    CKpaOpt,
    ElementOpt,
    JsonOpt,
    NoWaitOpt,
    OutOpt,
    QuietOpt,
    TemplatesOpt,
    VerboseOpt,
)
from limbcli.cli.terminal import emit, terminal
from limbcli.mesh_bounds import LIMB_CUT_MM, LIMB_NODES, LIMB_SITE_SIZE_MM
from limbcli.output_lock import one_writer

NodesOpt = Annotated[
    int,
    typer.Option(
        "--nodes",
        min=LIMB_NODES[0],
        max=LIMB_NODES[1],
        help="About this number of nodes; the edges follow from it.",
    ),
]
CutOpt = Annotated[
    float | None,
    typer.Option(
        "--cut-mm",
        min=LIMB_CUT_MM[0],
        max=LIMB_CUT_MM[1],
        help="Height of the proximal cut above the distal end; default: where the images end.",
        show_default=False,
    ),
]
SiteSizeOpt = Annotated[
    float | None,
    typer.Option(
        "--site-size-mm",
        min=LIMB_SITE_SIZE_MM[0],
        max=LIMB_SITE_SIZE_MM[1],
        help="Edge length round the sites, such as 3 to set a probe there; default: as elsewhere.",
        show_default=False,
    ),
]
DistalOpt = Annotated[
    bool, typer.Option("--distal-cut", help="Accept a limb whose distal end was not imaged: it stays free.")
]
SkinOpt = Annotated[
    str | None,
    typer.Option(
        "--skin-mm", metavar="MM|mri", help="Thickness of a skin layer, 0 for none; default: the sites'.",
        show_default=False,
    ),
]  # fmt: skip
FatOpt = Annotated[
    str | None,
    typer.Option(
        "--fat-mm", metavar="MM|mri", help="The same for a fat layer below the skin.", show_default=False
    ),
]
DrawOpt = Annotated[
    list[int] | None,
    typer.Option(
        "--draw",
        help="Also write the model of this draw (0 to 49) of the stiffness field; repeatable.",
        show_default=False,
    ),
]


def command(
    case: CaseArg,
    out: OutOpt = None,
    element: ElementOpt = None,
    nodes: NodesOpt = 40_000,
    site_size: SiteSizeOpt = None,
    cut: CutOpt = None,
    distal_cut: DistalOpt = False,
    skin: SkinOpt = None,
    fat: FatOpt = None,
    c_kpa: CKpaOpt = None,
    draw: DrawOpt = None,
    templates: TemplatesOpt = None,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Build the finite-element model of the whole limb, with named parts, for FEBio and others."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.limb import LimbOptions, limb
    from limbcli.stages.site_model.site_layers import thickness_of

    opened, target = Case.open_images(case), out or default_out(case)
    options = LimbOptions(
        element=element,
        nodes=nodes,
        cut=cut,
        distal_cut=distal_cut,
        skin_layer=None if skin is None else thickness_of(skin, "--skin-mm"),
        fat_layer=None if fat is None else thickness_of(fat, "--fat-mm"),
        c_kpa=c_kpa,
        site_size=site_size,
        draws=tuple(draw or ()),
    )
    progress = terminal(quiet=quiet, verbose=verbose)
    with one_writer(target, wait=not no_wait, progress=progress):
        result = limb(opened, out=target, options=options, templates=templates, progress=progress)
    emit([result], as_json=json)
