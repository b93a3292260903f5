"""What a simulated measurement of a case's sites is to be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from limbcli.model import LimbModel
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.shear_waves.pixels import Window
from limbcli.stages.simulated_subjects.hidden_effects import Hidden
from limbcli.stages.simulated_subjects.indent import KnownTissue
from limbcli.stages.simulated_subjects.known_stretches import KnownStretches

Alter = Callable[[LimbModel], LimbModel]


@dataclass(frozen=True)
class SynthOptions:
    """What to simulate, and how to measure it.

    element None is the case's; size, far_size, margin : of the mesh simulated on (mm), None the
    usual ones; same_mesh : simulate on the mesh that `mesh` made for the case instead;
    contact_penalty : multiple of the skin's stiffness at rest (None: that of build-feb), of which a large
    one keeps the probe from sinking in; noise : factor on the case's [site.noise] (0: none);
    layers : read skin, fat and muscle too, as thick at first touch as `segment` found them;
    alter : a change of the meshed model; hidden : effects in tissue and readings;
    stretches : true ones of the states that the case's sites have.
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
    window: Window = field(default_factory=Window)
    alter: Alter | None = None
    hidden: tuple[Hidden, ...] = ()
    layers: bool = False
    stretches: KnownStretches = field(default_factory=KnownStretches)
