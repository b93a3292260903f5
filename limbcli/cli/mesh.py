"""`limbcli mesh CASE`."""

from __future__ import annotations

from typing import Annotated

import typer

from limbcli.cli.options import CaseArg, ElementOpt, JsonOpt, NoWaitOpt, OutOpt, QuietOpt, SiteOpt, VerboseOpt
from limbcli.cli.terminal import emit, terminal
from limbcli.mesh_bounds import FAR_SIZE_MM, MARGIN_MM, SIZE_MM
from limbcli.output_lock import one_writer

SizeOpt = Annotated[
    float | None,
    typer.Option(
        "--size-mm",
        min=SIZE_MM[0],
        max=SIZE_MM[1],
        help="Edge length under the probe; default 2.5.",
        show_default=False,
    ),
]
FarSizeOpt = Annotated[
    float | None,
    typer.Option(
        "--far-size-mm",
        min=FAR_SIZE_MM[0],
        max=FAR_SIZE_MM[1],
        help="Edge length far from it; default 8, or --size-mm.",
        show_default=False,
    ),
]
MarginOpt = Annotated[
    float | None,
    typer.Option(
        "--margin-mm",
        min=MARGIN_MM[0],
        max=MARGIN_MM[1],
        help="Tissue kept beyond the probe; default: the case's.",
        show_default=False,
    ),
]
SkinOpt = Annotated[
    str | None,
    typer.Option(
        "--skin-mm", metavar="MM|mri", help="Thickness of a skin layer, 0 for none; default: the case's.",
        show_default=False,
    ),
]  # fmt: skip
FatOpt = Annotated[
    str | None,
    typer.Option(
        "--fat-mm", metavar="MM|mri",
        help="Thickness of a fat layer below the skin, 0 for none; mri: as segmented at the site; "
        "default: the case's.",
        show_default=False,
    ),
]  # fmt: skip
AtOpt = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--at",
        metavar="ANGLE_DEG HEIGHT_MM",
        help="Place the site by angle round the limb (0 anterior, 90 the patient's left) and height above "
        "its distal end, instead of the case's place.",
        show_default=False,
    ),
]
StudyOpt = Annotated[
    bool,
    typer.Option(
        "--study", help="Also solve finer and coarser meshes and smaller and larger models (minutes)."
    ),
]


def command(
    case: CaseArg,
    out: OutOpt = None,
    site: SiteOpt = None,
    element: ElementOpt = None,
    size: SizeOpt = None,
    far_size: FarSizeOpt = None,
    margin: MarginOpt = None,
    skin: SkinOpt = None,
    fat: FatOpt = None,
    at: AtOpt = None,
    study: StudyOpt = False,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Build the local finite-element model of a site from the surfaces."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.mesh import mesh
    from limbcli.stages.site_model.site_layers import thickness_of

    opened, target = Case.open(case), out or default_out(case)
    progress = terminal(quiet=quiet, verbose=verbose)
    with one_writer(target, wait=not no_wait, progress=progress):
        results = mesh(
            opened,
            out=target,
            sites=site,
            element=element,
            size=size,
            far_size=far_size,
            margin=margin,
            skin_layer=None if skin is None else thickness_of(skin, "--skin-mm"),
            fat_layer=None if fat is None else thickness_of(fat, "--fat-mm"),
            place=at,
            study=study,
            progress=progress,
        )
    emit(results, as_json=json)
