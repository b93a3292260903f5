"""Options that `phantom` and `synth` share: the known tissue, its measurement, the mesh simulated on."""

from __future__ import annotations

from typing import Annotated

import typer

_TISSUE = "Known tissue"
_MEASURING = "Measuring it"
_MESH = "Mesh simulated on"

CStiffOpt = Annotated[
    float, typer.Option("--c-kpa", min=0.1, max=200.0, help="c = 2 mu.", rich_help_panel=_TISSUE)
]
FKappaOpt = Annotated[
    float, typer.Option("--f-kappa", min=0.01, max=1000.0, help="kappa' / c.", rich_help_panel=_TISSUE)
]
MOpt = Annotated[
    float, typer.Option("--m", min=1.0, max=100.0, help="Exponent of the law.", rich_help_panel=_TISSUE)
]
EffectOpt = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="ID[=SIZE]",
        help="Hide this effect in the data (may be repeated).",
        show_default=False,
        rich_help_panel=_TISSUE,
    ),
]
NoiseOpt = Annotated[
    float,
    typer.Option(
        "--noise", min=0.0, max=20.0, help="Factor on the stated noise; 0: none.", rich_help_panel=_MEASURING
    ),
]
StepOpt = Annotated[
    float, typer.Option("--step-n", min=0.1, max=20.0, help="Force step, N.", rich_help_panel=_MEASURING)
]
MaxForceOpt = Annotated[
    float,
    typer.Option("--max-force-n", min=1.0, max=80.0, help="Largest force, N.", rich_help_panel=_MEASURING),
]
MaxStrainOpt = Annotated[
    float,
    typer.Option(
        "--max-strain",
        min=0.05,
        max=0.6,
        help="Largest depth over skin-bone distance.",
        rich_help_panel=_MEASURING,
    ),
]
SynthElementOpt = Annotated[
    str | None,
    typer.Option(
        "--element", help="tet10 | tet4; default: the case's.", rich_help_panel=_MESH, show_default=False
    ),
]
SynthSizeOpt = Annotated[
    float,
    typer.Option("--size-mm", min=0.3, max=20, help="Edge length under the probe.", rich_help_panel=_MESH),
]
SynthFarSizeOpt = Annotated[
    float,
    typer.Option("--far-size-mm", min=0.3, max=50, help="Edge length far from it.", rich_help_panel=_MESH),
]
SynthMarginOpt = Annotated[
    float | None,
    typer.Option(
        "--margin-mm",
        min=5,
        max=150,
        help="Tissue kept beyond the probe; default: the case's.",
        rich_help_panel=_MESH,
        show_default=False,
    ),
]
SameMeshOpt = Annotated[
    bool,
    typer.Option("--same-mesh", help="Simulate on the very mesh that is fitted.", rich_help_panel=_MESH),
]
ContactPenaltyOpt = Annotated[
    float | None,
    typer.Option(
        "--contact-penalty",
        min=1.0,
        max=1000.0,
        help="Times the skin's stiffness at rest; default: 20. With more the probe sinks in less.",
        rich_help_panel=_MESH,
        show_default=False,
    ),
]
