"""Options shared by `phantom` and `synth`: the known tissue, its measurement, and the mesh of the simulation.

Names, defaults and bounds are defined only here; `with_synth_options` adds them to a command.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from limbcli.cli.options import ElementOpt
from limbcli.mesh_bounds import FAR_SIZE_MM, MARGIN_MM, SIZE_MM

if TYPE_CHECKING:
    from limbcli.stages.simulated_subjects.synth_options import SynthOptions


CStiffOpt = Annotated[
    float, typer.Option("--c-kpa", min=0.1, max=200.0, help="c = 2 mu of the known tissue.")
]
FKappaOpt = Annotated[
    float, typer.Option("--f-kappa", min=0.01, max=1000.0, help="kappa' / c of the known tissue.")
]
MOpt = Annotated[
    float, typer.Option("--m", min=1.0, max=100.0, help="Exponent of the law, of the known tissue.")
]
EffectOpt = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="ID[=SIZE]",
        help="Hide this effect in the data (may be repeated). SIZE is the value of its first "
        "parameter, as in the list of effects, such as skin-layer=2.3; default: its typical one.",
        show_default=False,
    ),
]
NoiseOpt = Annotated[
    float,
    typer.Option("--noise", min=0.0, max=20.0, help="Factor on the stated noise; 0: none."),
]
StepOpt = Annotated[float, typer.Option("--step-n", min=0.1, max=20.0, help="Force step, N.")]
MaxForceOpt = Annotated[
    float,
    typer.Option("--max-force-n", min=1.0, max=80.0, help="Largest force, N."),
]
MaxStrainOpt = Annotated[
    float,
    typer.Option(
        "--max-strain",
        min=0.05,
        max=0.6,
        help="Largest depth over skin-bone distance.",
    ),
]
SynthSizeOpt = Annotated[
    float,
    typer.Option(
        "--size-mm",
        min=SIZE_MM[0],
        max=SIZE_MM[1],
        help="Edge length under the probe, of the mesh simulated on.",
    ),
]
SynthFarSizeOpt = Annotated[
    float,
    typer.Option(
        "--far-size-mm",
        min=FAR_SIZE_MM[0],
        max=FAR_SIZE_MM[1],
        help="Edge length far from it, of the mesh simulated on.",
    ),
]
SynthMarginOpt = Annotated[
    float | None,
    typer.Option(
        "--margin-mm",
        min=MARGIN_MM[0],
        max=MARGIN_MM[1],
        help="Tissue kept beyond the probe; default: the case's.",
        show_default=False,
    ),
]
SameMeshOpt = Annotated[
    bool,
    typer.Option("--same-mesh", help="Simulate on the same mesh that is fitted."),
]
ContactPenaltyOpt = Annotated[
    float | None,
    typer.Option(
        "--contact-penalty",
        min=1.0,
        max=1000.0,
        help="Times the skin's stiffness at rest; default: 20. With more the probe sinks in less.",
        show_default=False,
    ),
]


def _plan(
    c_kpa: CStiffOpt = 8.0,
    f_kappa: FKappaOpt = 80.0,
    m: MOpt = 6.0,
    effect: EffectOpt = None,
    noise: NoiseOpt = 1.0,
    step_n: StepOpt = 2.0,
    max_force_n: MaxForceOpt = 12.0,
    max_strain: MaxStrainOpt = 0.45,
    element: ElementOpt = None,
    size_mm: SynthSizeOpt = 4.0,
    far_size_mm: SynthFarSizeOpt = 12.0,
    margin_mm: SynthMarginOpt = None,
    same_mesh: SameMeshOpt = False,
) -> Any:
    """What to simulate and measure, from the options."""
    from limbcli.stages.simulated_subjects.hidden_effects import hide
    from limbcli.stages.simulated_subjects.indent import KnownTissue
    from limbcli.stages.simulated_subjects.synth_options import LoadingProtocol, SynthOptions

    return SynthOptions(
        tissue=KnownTissue(c_kpa=c_kpa, f_kappa=f_kappa, m=m),
        noise=noise,
        element=element,
        size=size_mm,
        far_size=far_size_mm,
        margin=margin_mm,
        same_mesh=same_mesh,
        hidden=tuple(hide(each) for each in effect or ()),
        protocol=LoadingProtocol(step=step_n, max_force=max_force_n, max_strain=max_strain),
    )


def with_synth_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add these options to a command in place of its parameter `plan`, which it gets as `SynthOptions`."""
    shared = inspect.signature(_plan).parameters
    hints = get_type_hints(_plan, include_extras=True) | get_type_hints(command, include_extras=True)
    own = inspect.signature(command)
    merged = [
        each.replace(annotation=hints[each.name])
        for given in own.parameters.values()
        for each in (shared.values() if given.name == "plan" else [given])
    ]

    @functools.wraps(command)
    def called(**given: Any) -> None:
        plan: SynthOptions = _plan(**{name: given.pop(name) for name in shared})
        command(plan=plan, **given)

    called.__signature__ = own.replace(parameters=merged)  # type: ignore[attr-defined]
    called.__annotations__ = {each.name: each.annotation for each in merged} | {"return": None}
    return called
