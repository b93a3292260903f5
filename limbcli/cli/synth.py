"""`limbcli synth CASE --out-case DIR`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from limbcli.cli.options import CaseArg, JsonOpt, NoWaitOpt, OutOpt, QuietOpt, SiteOpt, VerboseOpt
from limbcli.cli.synth_options import ContactPenaltyOpt, with_synth_options
from limbcli.cli.terminal import emit, terminal
from limbcli.output_lock import one_writer

OutCaseOpt = Annotated[
    Path, typer.Option("--out-case", metavar="DIR", help="Case folder to create.", show_default=False)
]
SeedOpt = Annotated[int, typer.Option("--seed", min=0, help="Random seed of the measurement noise.")]
LayersOpt = Annotated[
    bool,
    typer.Option(
        "--with-layers",
        help="Also simulate readings of the skin, fat and muscle thickness, as in the geometry.",
    ),
]
StretchAlongOpt = Annotated[
    list[str] | None,
    typer.Option(
        "--stretch-along", metavar="STATE=STRETCH", show_default=False,
        help="Stretch, relative to unloaded tissue, of a state whose stretch the case does not give (may be "
            "repeated).",
    ),
]  # fmt: skip
StretchAroundOpt = Annotated[
    list[str] | None,
    typer.Option(
        "--stretch-around", metavar="STATE=STRETCH", show_default=False,
        help="The same around the limb.",
    ),
]  # fmt: skip
UnloadedAlongOpt = Annotated[
    float | None,
    typer.Option(
        "--unloaded-stretch-along", min=0.5, max=2.0, show_default=False,
        help="Stretch, on the scale of the case, at which the tissue is unloaded.",
    ),
]  # fmt: skip
UnloadedAroundOpt = Annotated[
    float | None,
    typer.Option(
        "--unloaded-stretch-around", min=0.5, max=2.0, show_default=False,
        help="The same around the limb.",
    ),
]  # fmt: skip
ForceOpt = Annotated[bool, typer.Option("--force", help="Replace DIR if synth made it.")]


@with_synth_options
def command(
    case: CaseArg,
    out_case: OutCaseOpt,
    out: OutOpt = None,
    site: SiteOpt = None,
    seed: SeedOpt = 7,
    force: ForceOpt = False,
    plan: Any = None,
    with_layers: LayersOpt = False,
    contact_penalty: ContactPenaltyOpt = None,
    stretch_along: StretchAlongOpt = None,
    stretch_around: StretchAroundOpt = None,
    unloaded_stretch_along: UnloadedAlongOpt = None,
    unloaded_stretch_around: UnloadedAroundOpt = None,
    no_wait: NoWaitOpt = False,
    json: JsonOpt = False,
    quiet: QuietOpt = False,
    verbose: VerboseOpt = 0,
) -> None:
    """Simulate measurements with known parameters on the geometry of an existing case, as a new case."""
    from limbcli.case import Case
    from limbcli.case.parts import Stretch
    from limbcli.config import default_out
    from limbcli.stages.simulated_subjects.known_stretches import known_stretches, parse_stretches
    from limbcli.stages.synth import synth

    stretches = known_stretches(
        parse_stretches(stretch_along or [], option="--stretch-along"),
        parse_stretches(stretch_around or [], option="--stretch-around"),
        Stretch(unloaded_stretch_along, unloaded_stretch_around),
    )
    options = replace(
        plan, seed=seed, contact_penalty=contact_penalty, layers=with_layers, stretches=stretches
    )
    opened, target = Case.open(case), out or default_out(case)
    progress = terminal(quiet=quiet, verbose=verbose)
    with one_writer(target, wait=not no_wait, progress=progress):
        result = synth(
            opened, out=target, out_case=out_case, sites=site, options=options, force=force, progress=progress
        )
    emit(result, as_json=json)
