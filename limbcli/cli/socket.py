"""`limbcli socket CASE`."""

from __future__ import annotations

from typing import Annotated

import typer

from limbcli.cli.options import CaseArg, JsonOpt, NoWaitOpt, OutOpt, QuietOpt, VerboseOpt
from limbcli.cli.terminal import emit, terminal
from limbcli.mesh_bounds import SOCKET_PENALTY, SOCKET_STEPS
from limbcli.output_lock import one_writer

AlignOpt = Annotated[
    bool, typer.Option("--align", help="Place the socket of [socket] by its shape: it is in another frame.")
]
DonningOpt = Annotated[
    int, typer.Option("--donning-steps", min=SOCKET_STEPS[0], max=SOCKET_STEPS[1], help="Steps of donning.")
]
LoadStepsOpt = Annotated[
    int, typer.Option("--load-steps", min=SOCKET_STEPS[0], max=SOCKET_STEPS[1], help="Steps of each load.")
]
PenaltyOpt = Annotated[
    float,
    typer.Option(
        "--contact-penalty",
        min=SOCKET_PENALTY[0],
        max=SOCKET_PENALTY[1],
        help="Of the contact, as a multiple of the tissue's stiffness: higher is stricter, and slower.",
    ),
]
IntervalsOpt = Annotated[
    bool, typer.Option("--intervals/--no-intervals", help="Solve again for intervals over the limb's draws.")
]


def command(
    case: CaseArg,
    out: OutOpt = None,
    align: AlignOpt = False,
    donning_steps: DonningOpt = 10,
    load_steps: LoadStepsOpt = 5,
    contact_penalty: PenaltyOpt = 20.0,
    intervals: IntervalsOpt = True,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Put the limb into its socket and load it: pressure and shear on the skin, by patch. After `limb`."""
    from limbcli.case import Case
    from limbcli.config import default_out
    from limbcli.stages.socket import SocketOptions, socket

    opened, target = Case.open_images(case), out or default_out(case)
    options = SocketOptions(align, donning_steps, load_steps, contact_penalty, intervals)
    progress = terminal(quiet=quiet, verbose=verbose)
    with one_writer(target, wait=not no_wait, progress=progress):
        result = socket(opened, out=target, options=options, progress=progress)
    emit([result], as_json=json)
