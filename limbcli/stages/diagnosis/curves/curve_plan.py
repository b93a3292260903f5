"""Range of depth of a site's curves, and solver settings of its simulations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from limbcli.effects.curves import Curves
from limbcli.model import Array, LimbModel

# m -> a model, and its nodal displacements (n_points, 3) in mm, by depth (mm)
LevelsAt = Callable[[float], tuple[LimbModel, Mapping[float, Array]]]

_TOLERANCE = 1e-3  # relative residual; changes forces by 3e-4; 1e-4 takes up to six times as long at folds


@dataclass(frozen=True)
class Reach:
    """How far to simulate curves.

    needed : mm, the depth to be reached; deeper levels are tried briefly, at m 4 only. None: all depths
    enough_force : N (at the simulations' c), larger than any reading: the simulation ends at the first level
        with this force
    beside : m -> curves of the same depths on another mesh, along which curves are extrapolated where this
        one's solver stops
    begin : levels on another mesh at an m, used as initial guess
    enough : fraction of the depth needed that must be reached by the solver
    """

    needed: float | None = None
    enough_force: float | None = None
    beside: Callable[[float], Curves] | None = None
    begin: LevelsAt | None = None
    enough: float = 0.7


@dataclass(frozen=True)
class Solving:
    """Solver settings of a simulation.

    tolerance : of the residual relative to the forces; threads : of the linear solver
    penalty : of the contact; None: four times that of the usual model
    """

    tolerance: float = _TOLERANCE
    threads: int = 2
    penalty: float | None = None
