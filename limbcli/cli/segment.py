"""`limbcli segment CASE`."""

from __future__ import annotations

from typing import Annotated

import typer

from limbcli.cli.choices import LIMBS, among, such_as
from limbcli.cli.options import CaseArg, JsonOpt, NoWaitOpt, OutOpt, QuietOpt, VerboseOpt
from limbcli.cli.terminal import emit, terminal
from limbcli.output_lock import one_writer

SeedOpt = Annotated[
    list[str] | None,
    typer.Option(
        "--seed",
        metavar="KIND=X,Y,Z",
        help="A point (patient LPS, mm) in the marrow of a missed bone (bone=...), "
        "or in soft tissue wrongly labelled as bone (soft=...). May be repeated.",
        **such_as(lambda: ["bone=", "soft="]),
    ),
]
SmoothOpt = Annotated[
    float, typer.Option("--smooth", metavar="MM", min=0.0, max=5.0, help="Smoothing of the surfaces, mm.")
]
ThresholdOpt = Annotated[
    float | None,
    typer.Option(
        "--threshold",
        metavar="SIGNAL",
        help="Signal between air and skin, in the image's units (HU on CT); default: found.",
        show_default=False,
    ),
]
LimbOpt = Annotated[
    str | None,
    typer.Option(
        "--limb",
        metavar="left|right",
        help="Which limb, if two are in view; default: the case's.",
        show_default=False,
        **among(*LIMBS),
    ),
]
AcceptBonesOpt = Annotated[
    bool,
    typer.Option(
        "--accept-bones",
        help="Of bones outside the skin, keep what is inside; default: they are an error.",
    ),
]
AopOpt = Annotated[bool, typer.Option("--aop", help="Also skin.aop, the skin for prosthetic CAD programs.")]
FreshOpt = Annotated[
    bool, typer.Option("--fresh", help="Discard a label map that was edited by hand and start anew.")
]


def command(
    case: CaseArg,
    out: OutOpt = None,
    seed: SeedOpt = None,
    smooth: SmoothOpt = 0.7,
    threshold: ThresholdOpt = None,
    limb: LimbOpt = None,
    accept_bones: AcceptBonesOpt = False,
    aop: AopOpt = False,
    fresh: FreshOpt = False,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Segment an MRI or CT series into a label map, closed surfaces and markers.

    A label map edited by hand in the output folder (labels.nii.gz) takes precedence over the automatic one.
    If a site is not on the skin, the command ends with an error after everything is written.
    """
    seeds = [_seed(each) for each in seed or []]
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.errors import CaseError
    from limbcli.errors.problems import raise_errors
    from limbcli.stages.segment import segment
    from limbcli.stages.segmenting.places import site_errors

    opened, target = Case.open_images(case), out or default_out(case)
    progress = terminal(quiet=quiet, verbose=verbose)
    with one_writer(target, wait=not no_wait, progress=progress):
        result = segment(
            opened,
            out=target,
            seeds=seeds,
            smooth=smooth,
            threshold=threshold,
            limb=limb,  # type: ignore[arg-type]
            accept_bones=accept_bones,
            aop=aop,
            fresh=fresh,
            progress=progress,
        )
    emit(result, as_json=json)
    raise_errors(site_errors(result.data, str(opened.file)), CaseError)


def _seed(text: str) -> tuple[str, tuple[float, float, float]]:
    """
    >>> _seed("bone=1,-2.5,30")
    ('bone', (1.0, -2.5, 30.0))
    """
    kind, _, places = text.partition("=")
    try:
        x, y, z = (float(each) for each in places.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} is not KIND=X,Y,Z", param_hint="--seed") from error
    if kind not in ("bone", "soft"):
        raise typer.BadParameter(f"{kind!r} is neither bone nor soft", param_hint="--seed")
    return kind, (x, y, z)
