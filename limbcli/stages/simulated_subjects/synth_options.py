"""Options of the simulated measurements of a case's sites."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from limbcli.model import LimbModel
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.stages.simulated_subjects.hidden_effects import Hidden
from limbcli.stages.simulated_subjects.indent import KnownTissue
from limbcli.stages.simulated_subjects.known_stretches import KnownStretches

Alter = Callable[[LimbModel], LimbModel]


@dataclass(frozen=True, kw_only=True)
class SynthOptions:
    """What to simulate, and how to measure it.

    element : None for the case's; size, far_size, margin : of the simulated mesh (mm), None for the
        defaults; same_mesh : simulate on the case's own mesh instead
    contact_penalty : multiple of the skin's stiffness at rest (None: that of build-feb); a large one
        prevents penetration of the probe
    noise : factor on the case's [site.noise] (0: none)
    layers : also read skin, fat and muscle, whose thickness at first touch is that found by `segment`
    alter : change of the meshed model; hidden : effects in tissue and readings
    stretches : true stretches of the states of the case's sites
    """

    tissue: KnownTissue = field(default_factory=KnownTissue)
    seed: int = 7
    noise: float = 1.0
    element: str | None = None
    size: float | None = 4.0
    far_size: float | None = 12.0
    margin: float | None = None
    same_mesh: bool = False
    contact_penalty: float | None = None
    protocol: LoadingProtocol = field(default_factory=LoadingProtocol)
    alter: Alter | None = None
    hidden: tuple[Hidden, ...] = ()
    layers: bool = False
    stretches: KnownStretches = field(default_factory=KnownStretches)
