"""Multithreaded loops over the tissue's cells: internal forces, volume ratios, tangent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from limbcli.fem.elements import kernels, mean_dilatation, simd_kernels
from limbcli.fem.elements.assembly import Pattern, Threads, total
from limbcli.fem.elements.groups import Group, Operands
from limbcli.fem.elements.thread_partition import Halves
from limbcli.fem.motion.state import State
from limbcli.model import Array

_NO_VOLUMES = np.zeros((0, 1))


class ElementLoops:
    """The tissue's cell groups, with material parameters at the current time.

    X (n_points, 3) : reference positions
    scales, histories : scale and history stress of viscoelastic laws, by group (see `equilibrium.history`)
    """

    X: Array
    threads: Threads
    pattern: Pattern
    groups: list[Group]
    halves: list[Halves]
    operands: list[Operands]
    scales: list[float]
    histories: list[Array]

    def internal(self, state: State) -> tuple[Array, float, tuple[int, int]]:
        """Internal nodal forces (n_points, 3), smallest det F, and its (group, cell)."""
        parts = [np.zeros_like(self.X) for _ in range(self.threads.n)]
        worst, worst_cell = np.inf, (-1, -1)
        for k, o in enumerate(self.operands):
            found = self._add(simd_kernels.internal_force, state, o, o.arguments(), parts)
            low, cell = min(found)
            if low < worst:
                worst, worst_cell = low, (k, cell)
            if o.bulk is not None:
                args = (o.cells, o.grad, o.weight, o.base, *self._volume_terms(state, k))
                self._add(kernels.volume_force, state, o, args, parts)
        return total(parts), worst, worst_cell

    def smallest_mean_volume(self, state: State) -> tuple[float, tuple[int, int]]:
        """Smallest determinant of a cell's mean F, and its (group, cell).

        A curved quadratic cell may be inverted although det F is positive at all of its integration points.
        """
        worst, worst_cell = np.inf, (-1, -1)
        for k, (group, o) in enumerate(zip(self.groups, self.operands, strict=True)):
            F = o.base + np.einsum("eni,enj->eij", state.u[o.cells], group.mean_grad(o.grad))
            low = np.linalg.det(F)
            if len(low) and low.min() < worst:
                worst, worst_cell = float(low.min()), (k, int(low.argmin()))
        return worst, worst_cell

    def linear_volumes(self, state: State, v: Array) -> tuple[Array, ...]:
        """det F of every group (n_cells, n_gauss), plus its linear change along v (n_points, 3)."""
        return tuple(self._linear_volumes(state, v, o) for o in self.operands)

    def _linear_volumes(self, state: State, v: Array, o: Operands) -> Array:
        out = np.empty(o.weight.shape)
        self._add(kernels.linear_volumes, state, o, (v, o.cells, o.grad, o.base), [out] * self.threads.n)
        return out

    def volume_force(self, state: State) -> Array:
        """Change (n_points, 3) of the internal forces if pressures are evaluated at the independent volume
        ratios `state.volumes` instead of det F."""
        parts = [np.zeros_like(self.X) for _ in range(self.threads.n)]
        for o, volumes in zip(self.operands, state.volumes, strict=True):
            if o.bulk is not None:  # its pressure has a volume ratio of its own
                continue
            args = (o.cells, o.grad, o.weight, o.base, o.lame, volumes)
            self._add(kernels.volume_force, state, o, args, parts)
        return total(parts)

    def stiffness(self, state: State) -> Array:
        """Blocks (n_pairs, 3, 3) of the symmetric part of the elastic tangent, without contact, for all node
        pairs (see `Pattern`)."""
        n_pairs = len(self.pattern.high)
        blocks = np.zeros((n_pairs + max((len(h.shared) for h in self.halves), default=0), 3, 3))
        for k, (o, halves) in enumerate(zip(self.operands, self.halves, strict=True)):
            args = (*o.arguments(), *self._volume_terms(state, k), halves.order, halves.pairs, blocks)

            def task(_: int, begin: int, end: int, args: tuple[Any, ...] = args) -> None:
                simd_kernels.tangent(begin, end, state.u, *args)

            self.threads.run_halves(task, len(o.cells))
            extra = blocks[n_pairs : n_pairs + len(halves.shared)]
            blocks[halves.shared] += extra
            extra[:] = 0.0
            if o.bulk is not None:
                factors, b = self._of_volumes(state, o)
                mean_dilatation.add_stiffness(factors, b, self.pattern.pairs[k], blocks)
        return blocks[:n_pairs]

    def tangent_times(self, state: State, v: Array) -> Array:
        """Elastic tangent of all nodes times v (n_points, 3), including the slope of stress jumps."""
        parts = [np.zeros_like(self.X) for _ in range(self.threads.n)]
        for k, o in enumerate(self.operands):
            args = (*o.sloped().arguments(), *self._volume_terms(state, k), v)
            self._add(kernels.tangent_times, state, o, args, parts)
            if o.bulk is not None:
                factors, b = self._of_volumes(state, o)
                change = factors * np.einsum("eni,eni->e", b, v[o.cells])
                np.add.at(parts[0], o.cells, change[:, None, None] * b)
        return total(parts)

    def _of_volumes(self, state: State, o: Operands) -> tuple[Array, Array]:
        """Stiffness against a change of every cell's volume, and the gradient of its volume."""
        J = self._linear_volumes(state, np.zeros_like(self.X), o)
        return mean_dilatation.stiffnesses(o, J), mean_dilatation.volume_gradients(o, state.u)

    def _volume_terms(self, state: State, group: int) -> tuple[Array, Array]:
        """Stiffness of the pressure against volume ratios, and the independent volume ratios."""
        o = self.operands[group]
        if o.bulk is not None:
            J = self._linear_volumes(state, np.zeros_like(self.X), o)
            return o.bulk, mean_dilatation.equivalent_volumes(o, J)
        volumes = state.volumes[group] if state.volumes else _NO_VOLUMES
        return self.operands[group].lame, volumes

    def _add(
        self, kernel: Callable[..., Any], state: State, o: Operands, args: tuple[Any, ...], parts: list[Array]
    ) -> list[Any]:
        """Run a kernel over a group's cells; each thread adds to its own array."""

        def task(worker: int, begin: int, end: int) -> Any:
            return kernel(begin, end, state.u, *args, parts[worker])

        return self.threads.run(task, len(o.cells))


def states_at_points(
    threads: Threads, o: Operands, u: Array, *, tangent: bool = False
) -> tuple[Array, Array, Array]:
    """F (n_cells, n_gauss, 3, 3) passed to the law, second Piola-Kirchhoff stress S (..., 6), and dS/dE
    (..., 6, 6), empty without `tangent`, of a group's points at displacements u (n_points, 3)."""
    shape, args = o.weight.shape, o.arguments()
    F, S = np.empty((*shape, 3, 3)), np.empty((*shape, 6))
    CC = np.empty((*shape, 6, 6)) if tangent else np.zeros((0, 1, 6, 6))
    threads.run(lambda _, begin, end: kernels.stress_state(begin, end, u, *args, F, S, CC), len(o.cells))
    return F, S, CC
