"""Contribution of stress discontinuities to the tangent, which is not symmetric there.

Sheared fibres that begin to be stretched have a stress that jumps with the deformation; the jump is
represented by a finite slope. Few integration points lie on a jump. They are collected when the tangent is
assembled, so that matrix-vector products do not evaluate the law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.fem.elements import kernels
from limbcli.fem.elements.assembly import Threads, total
from limbcli.fem.elements.element_loops import states_at_points
from limbcli.fem.elements.groups import Operands
from limbcli.fem.motion.state import State
from limbcli.fem.system import System
from limbcli.model import Array, IntArray


@dataclass(frozen=True, eq=False)
class Points:
    """Integration points of one group that lie on a stress jump.

    nodes (n, n_nodes) : nodes of their cells; grad (n, n_nodes, 3) : shape gradients; F (n, 3, 3)
    slope (n, 6, 6) : the jump's part of d(second Piola stress)/d(Green strain), times the point's volume
    """

    nodes: IntArray
    grad: Array
    F: Array
    slope: Array


@dataclass(frozen=True, eq=False)
class Jumps:
    """All points on a jump, group by group."""

    groups: tuple[Points, ...]
    threads: Threads

    def times(self, v: Array) -> Array:
        """The jumps' part of the tangent times v (n_points, 3)."""
        parts = [np.zeros_like(v) for _ in range(self.threads.n)]
        for p in self.groups:

            def task(worker: int, begin: int, end: int, p: Points = p) -> None:
                kernels.slope_times(begin, end, p.nodes, p.grad, p.F, p.slope, v, parts[worker])

            self.threads.run(task, len(p.nodes))
        return total(parts)


def find_jumps(system: System, state: State) -> Jumps | None:
    """The integration points on a jump at a state; None if no law has jumps."""
    if not system.jumps:
        return None
    found = tuple(_points(system.threads, state, o) for o in system.operands if o.jumps)
    return Jumps(found, system.threads)


def _points(threads: Threads, state: State, o: Operands) -> Points:
    F, _, sloped = states_at_points(threads, o.sloped(), state.u, tangent=True)
    slope = sloped - states_at_points(threads, o, state.u, tangent=True)[2]
    cell, point = np.nonzero(np.abs(slope).max(axis=(2, 3)))
    weighted = slope[cell, point] * o.weight[cell, point, None, None]
    return Points(o.cells[cell], o.grad[cell, point], F[cell, point], weighted)
