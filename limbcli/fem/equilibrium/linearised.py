"""The tissue linearised at a state, against the contact as it is.

Every linear system has the tissue's tangent of the last assembly and the exact contact tangent,
which is not symmetric. It is solved by GMRES with a factor of the tissue's tangent of that or an
earlier state, in which the contact is kept up to date where the direct solver can do that.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.fem.equilibrium.free_motion import check_held
from limbcli.fem.equilibrium.settings import Counts, Settings
from limbcli.fem.equilibrium.tangent import Inverse, Tangent, assemble
from limbcli.fem.linear_solvers import direct as linear_solvers
from limbcli.fem.linear_solvers.krylov import gmres
from limbcli.fem.linear_solvers.singular import singular
from limbcli.fem.motion.state import State, norm
from limbcli.fem.system import System
from limbcli.model import Array

_LEAST_KRYLOV, _MAX_KRYLOV = 30, 40  # the less compressible, the more even a fresh factor needs
_OLD_KRYLOV = 1.5  # factorisations: Krylov iterations after which an older factor is given up
_LARGE = 6_000  # equations, from which on single precision pays
_FRESH = 2.0  # Krylov iterations a decade takes with a fresh factor
_PER_SOLVE = 0.7  # Krylov iterations that a factor is worth, over `solves_per_factor` (0.2 to 1.0 tried)
_OUTDATED = 0.4  # of a factorisation wasted, from which on a new factor is made
_MEMORY = 0.5  # of what older factors wasted: weight of the last
_FORGETTING = 0.9  # of the same, where none was tried
_ROUNDS = 8  # of contact in one step
_OLD_ROUNDS = 2  # of its patience: what an older factor may take over all of them
_NOWHERE = 0.999  # of the residual left by a factor of this very tangent: there is no step
_ROUGH = 0.1  # to which the linear system is solved while the set of touching points changes


class Linearised:
    """Tangent and factor of one system, and what solving with them costs.

    reuse_cost : Krylov iterations that a fresh factor would have saved, in factorisations: at 1 the old
        one has cost as much as a new one
    ageing : what an older factor has lately wasted at one tangent, in factorisations: above 1 none is used
        (the less compressible the tissue, the sooner its factor is too old)
    rate : Krylov iterations per decade, last time
    stuck : the last step was not solved for: the factor is too old to be of use
    drag : what holds the tissue where it is, in the next tangents (see `Newton.relax`)
    """

    def __init__(self, system: System, settings: Settings, counts: Counts):
        self.system, self.counts = system, counts
        self.tangent: Tangent | None = None
        self.inverse: Inverse | None = None
        self.reuse_cost = 0.0
        self.ageing = self._wasted = 0.0
        self.rate = _FRESH
        self.stuck = False
        self.drag = 0.0
        single = settings.single if settings.single is not None else system.n_tissue > _LARGE
        pattern = system.pattern
        self.linear: Any = (
            linear_solvers.make(
                pattern.indptr,
                pattern.indices,
                kind=settings.linear,
                threads=settings.threads,
                single=single,
                last=system.within_reach(),
            )
            if system.n_tissue
            else None
        )

    def forget(self) -> None:
        """As before the first tangent."""
        self.tangent = self.inverse = None
        self.reuse_cost = self.ageing = self._wasted = 0.0
        self.rate, self.stuck = _FRESH, False

    @property
    def is_outdated(self) -> bool:
        """Whether there is no factor, or one that has cost more than a new one, or will."""
        return self.inverse is None or self.reuse_cost > _OUTDATED or self.ageing > 1.0

    @property
    def per_factor(self) -> float:
        """What a factorisation costs, in Krylov iterations."""
        return _PER_SOLVE * float(self.linear.solves_per_factor) if self.linear is not None else 1.0

    @property
    def patience(self) -> int:
        """Krylov iterations after which a factor is given up: a new one is cheaper by then."""
        if self._is_old:
            return int(np.clip(_OLD_KRYLOV * self.per_factor, _LEAST_KRYLOV // 2, _MAX_KRYLOV))
        return int(np.clip(self.per_factor, _LEAST_KRYLOV, _MAX_KRYLOV))

    @property
    def _is_old(self) -> bool:
        """Whether the factor is of an earlier tangent."""
        return self.inverse is not None and self.inverse.tangent is not self.tangent

    def refresh(self, state: State, nodal: Array) -> None:
        """Assemble and factor the tangent at a state, the contact as searched last; `nodal` are the forces
        there."""
        self._learn()
        self.tangent = assemble(self.system, state, nodal, drag=self.drag)
        if state.time == 0.0:
            check_held(self.tangent, state)
        self.inverse = Inverse(self.tangent, state, self.linear)
        if state.time == 0.0 and self.linear is not None:
            linear_solvers.check_supported(self.linear)
        self.counts.factorisations += 1
        self.reuse_cost, self.rate = 0.0, _FRESH

    def assemble(self, state: State, nodal: Array) -> None:
        """The tangent at a state; the factor stays."""
        self._learn()
        self.tangent = assemble(self.system, state, nodal, drag=self.drag)

    def _learn(self) -> None:
        """Take what the factor wasted at the tangent that is left."""
        if self._is_old:
            self.ageing += _MEMORY * (self._wasted - self.ageing)
        else:
            self.ageing *= _FORGETTING
        self._wasted = 0.0

    def ready_for(self, n_solves: int, decades: float, state: State, nodal: Array) -> None:
        """The exact tangent at a state, with a new factor if that pays for so many solves to come."""
        wasted = n_solves * decades * (self.rate - _FRESH)
        if self.inverse is None or wasted > self.per_factor:
            self.refresh(state, nodal)
        elif self.tangent is None or self.tangent.state is not state:
            self.assemble(state, nodal)

    def solve(self, state: State, rhs: Array, tolerance: float) -> Array:
        """Solve with the tissue's tangent as assembled last and the contact's at `state`, searched last."""
        assert self.tangent is not None
        assert self.inverse is not None
        tangent = self.tangent
        self.inverse.follow(state)
        step, n, reached = gmres(
            lambda v: tangent.times(state, v),
            self.inverse,
            rhs,
            tolerance=tolerance,
            max_iterations=self.patience,
        )
        self.counts.krylov += n
        self.stuck = reached > max(3 * tolerance, 1e-9)
        if reached > _NOWHERE and not self._is_old:
            raise singular("no step removes the residual")
        decades = max(-np.log10(max(reached, 1e-16)), 0.3)
        self.rate = n / decades
        wasted = max(n - _FRESH * decades, 0.0) / self.per_factor
        self.reuse_cost += wasted
        self._wasted += wasted
        return step

    def settle(
        self, base: State, tissue: Array, goal: float, *, first: Array | None = None, far: bool = False
    ) -> Array:
        """Step from `base` to equilibrium between the linearised tissue and the contact as it is there.

        tissue : the tissue's part of the residual at `base`, which changes linearly
        goal : size of the residual that will do
        first : step to begin with
        far : the tractions are not yet near those of equilibrium (see `Pair.full_tangent`)

        Contact is searched anew after each linear solve: a semismooth Newton iteration (Hintermueller,
        Ito and Kunisch 2002, SIAM J. Optim. 13, 865-888), which needs no loop over the cells.
        """
        system, tangent = self.system, self.tangent
        assert tangent is not None
        step = np.zeros_like(tissue) if first is None else first
        at, searched = base, first is not None
        if searched:
            at, tissue = system.moved(base, step), tissue + tangent.tissue_times(step)
        residual = tissue + system.contact_residual(at, search=searched)
        best, touching = (np.inf, step), system.touching()
        rough = searched
        most = self.counts.krylov + _OLD_ROUNDS * self.patience
        for k in range(_ROUNDS):
            size = norm(residual)
            if size <= goal:
                return step
            relative = goal / size
            with system.full_contact_tangent(not far):
                change = self.solve(at, -residual, max(relative, _ROUGH) if rough else relative)
            moved = tangent.tissue_times(change)
            length, at, residual = self._shortened(base, tissue, step, change, moved, size)
            step, tissue = step + length * change, tissue + length * moved
            if norm(residual) < best[0]:
                best = (norm(residual), step)
            elif k > 1:
                break
            self.stuck |= self._is_old and self.counts.krylov >= most
            if self.stuck:
                break
            before, touching = touching, system.touching()
            rough = any((a != b).any() for a, b in zip(before, touching, strict=True))
        return best[1]

    def _shortened(
        self, base: State, tissue: Array, step: Array, change: Array, moved: Array, size: float
    ) -> tuple[float, State, Array]:
        """Length, state and residual: of the first length that brings it down, else of the best."""
        tried = []
        for length in (1.0, 0.5, 0.25):
            at = self.system.moved(base, step + length * change)
            residual = tissue + length * moved + self.system.contact_residual(at, search=True)
            if norm(residual) < size:
                return length, at, residual
            tried.append((norm(residual), length))
        length = min(tried)[1]
        at = self.system.moved(base, step + length * change)
        return length, at, tissue + length * moved + self.system.contact_residual(at, search=True)

    @property
    def n_unstable(self) -> int:
        """Negative pivots of the tissue's last factor: ways in which it would give way by itself."""
        return int(getattr(self.linear, "n_negative", 0))

    def close(self) -> None:
        if self.linear is not None:
            self.linear.close()
