"""A state of the model, and what acts at it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.fem.motion.rigid import BodyState
from limbcli.model import Array


def norm(v: Array) -> float:
    """Euclidean norm; waking the threads of a BLAS costs more than this sum."""
    return float(np.sqrt(np.einsum("i,i", v, v)))


@dataclass(frozen=True, eq=False)
class State:
    """Displacements u (n_points, 3) of all nodes, where the bodies are, and (where converged) what
    rigid facets the contact points are with.

    volumes : volume ratios (n_cells, n_gauss) of each group that pressures are taken at on the way to
        equilibrium; empty: those of u, as at equilibrium
    """

    time: float
    u: Array
    bodies: tuple[BodyState, ...]
    hints: tuple[Array, ...] = ()
    volumes: tuple[Array, ...] = ()


@dataclass(frozen=True, eq=False)
class RoughState(State):
    """A first guess that is rough from cell to cell and near on the whole: its residual says little."""


@dataclass(frozen=True, eq=False)
class Forces:
    """What acts at a state.

    nodal (n_points, 3) : internal plus contact force of every node; at held nodes the reaction
    bodies (n_bodies, 6) : force and moment needed from outside to hold each body
    residual : of the unknowns; scale : size of the forces at play (N)
    worst, place : smallest det F and its (group, cell)
    mixed : residual with the pressures taken at the state's own volume ratios
    """

    nodal: Array
    bodies: Array
    residual: Array
    scale: float
    n_touching: int
    worst: float
    place: tuple[int, int]
    mixed: Array

    @property
    def error(self) -> float:
        """Norm of the residual over the forces at play."""
        return norm(self.residual) / max(self.scale, 1e-14)
