"""How far a site's curves are to go, and how each of its simulations is solved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from limbcli.effects.curves import Curves
from limbcli.model import Array, LimbModel

# m -> a model, and displacements (n_points, 3) of its nodes in mm by depth (mm)
LevelsAt = Callable[[float], tuple[LimbModel, Mapping[float, Array]]]

_TOLERANCE = 1e-3  # moves forces by 3e-4; where the surface folds 1e-4 takes up to six times as long


@dataclass(frozen=True)
class Reach:
    """How far curves are to go.

    needed : mm, the depth to be reached; at m 4 the deeper levels are tried, briefly. None: all depths
    enough_force : N (at the simulations' c), beyond which no reading lies: the first level that bears it is
        the last
    beside : m -> curves of the same depths on another mesh, which lead where this one's solver stops
    begin : levels on another mesh at an m, that solves begin from
    """

    needed: float | None = None
    enough_force: float | None = None
    beside: Callable[[float], Curves] | None = None
    begin: LevelsAt | None = None


@dataclass(frozen=True)
class Solving:
    """How a simulation is solved.

    tolerance : residual over the forces at play; threads : of the linear solver
    penalty : of the contact; None: four times that of the usual model
    """

    tolerance: float = _TOLERANCE
    threads: int = 2
    penalty: float | None = None
