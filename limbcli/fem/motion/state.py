"""A state of the model, and the forces acting at it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from limbcli.fem.motion.rigid import BodyState
from limbcli.model import Array

if TYPE_CHECKING:
    from limbcli.fem.contacts.contact_state import ContactState


def norm(v: Array) -> float:
    """Euclidean norm without BLAS, whose thread start-up costs more than the sum."""
    return float(np.sqrt(np.einsum("i,i", v, v)))


@dataclass(frozen=True, eq=False)
class State:
    """Displacements u (n_points, 3) of all nodes, and positions of the bodies.

    hints : the rigid facet (-1: none) that each contact point touches, or touched at the state from which
        this one was reached; a contact search begins there. Empty: none
    volumes : independent volume ratios (n_cells, n_gauss) of each group, at which pressures are evaluated
        during the iteration; empty: the volume ratios of u, as at equilibrium
    """

    time: float
    u: Array
    bodies: tuple[BodyState, ...]
    hints: tuple[Array, ...] = ()
    volumes: tuple[Array, ...] = ()


@dataclass(frozen=True, eq=False)
class RoughState(State):
    """An initial guess with cell-by-cell errors but close displacements; its residual is not informative."""


@dataclass(frozen=True, eq=False)
class Forces:
    """Forces at a state.

    nodal (n_points, 3) : internal plus contact force less the loads, at every node; at constrained nodes the
        reaction
    bodies (n_bodies, 6) : external force and moment needed to hold each body in place
    residual : out-of-balance forces of the unknowns; scale : norm of the acting forces (N)
    contact : as found at the state
    worst, worst_cell : smallest det F and its (group, cell)
    iterated : residual with the pressures evaluated at the state's independent volume ratios, which the
        iteration makes vanish
    """

    nodal: Array
    bodies: Array
    residual: Array
    scale: float
    contact: ContactState
    worst: float
    worst_cell: tuple[int, int]
    iterated: Array

    @property
    def n_touching(self) -> int:
        return self.contact.n_touching

    @property
    def error(self) -> float:
        """Relative residual: norm of the residual over the norm of the acting forces."""
        return norm(self.residual) / max(self.scale, 1e-14)
