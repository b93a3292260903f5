"""Options of `fit`."""

from __future__ import annotations

from typing import Annotated

import typer

from limbcli.cli.choices import LAWS, OBJECTIVES, among, such_as

CDeviationOpt = Annotated[
    float | None,
    typer.Option(
        "--c-deviation-fraction",
        help="Standard deviation of c, relative; default: from the SWE noise.",
        show_default=False,
    ),
]
StiffnessMapOpt = Annotated[
    bool, typer.Option("--stiffness-map", help="c element by element, from the SWE map of level 0.")
]
ToleranceOpt = Annotated[float, typer.Option(help="Relative tolerance of cost and parameters.")]
MaxIterationsOpt = Annotated[int, typer.Option(min=1, help="Of each step.")]
IntervalsOpt = Annotated[bool, typer.Option(help="95 % intervals by profile likelihood.")]
TimeLimitOpt = Annotated[
    float | None, typer.Option("--time-limit-s", help="Time limit of each FEBio run.", show_default=False)
]
ObjectiveOpt = Annotated[
    str,
    typer.Option(
        help="force: the paper's, site by site. joint: depth and SWE; sites share the tissue. states: "
        "the same for the states of one site.",
        **among(*OBJECTIVES),
    ),
]
LawOpt = Annotated[
    str,
    typer.Option(
        help="Law for joint and states: ogden | mooney-rivlin | neo-hooke | two-term-ogden | holmes-mow | "
        "fibres.",
        **among(*LAWS),
    ),
]
CompareLawsOpt = Annotated[
    bool, typer.Option("--compare-laws", help="Joint only: compare all laws by the error of held-out levels.")
]
GainDeviationOpt = Annotated[
    float | None,
    typer.Option(
        "--gain-deviation-fraction",
        help="Numerical error of the force to allow for; default: mesh study, else by element and size.",
        show_default=False,
    ),
]
CycleOpt = Annotated[
    str,
    typer.Option(
        "--cycle",
        help="Loading cycle to fit, if there are several: a number, or last.",
        **such_as(lambda: ["last"]),
    ),
]
ContactCheckOpt = Annotated[
    bool,
    typer.Option(
        help="Also solve the fitted model with a stiffer contact, to quantify the probe's penetration."
    ),
]
BoundaryCheckOpt = Annotated[
    bool,
    typer.Option(
        help="Also solve the fitted model with the cut plane free, and with the limb's far side held; "
        "the intervals allow for both."
    ),
]
CompareElementOpt = Annotated[
    bool, typer.Option("--compare-element", help="Compare tet4 and tet10 on the same mesh.")
]
