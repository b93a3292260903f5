"""The linear systems of Newton's method: linearised tissue with the current contact.

The matrix of every linear system is the tissue tangent of the last assembly plus the exact contact
tangent, which is not symmetric. It is solved by GMRES, preconditioned with a factor of the tissue
tangent at the same or an earlier state; where the direct solver supports it, the contact part of the
factor is kept up to date.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.equilibrium.free_motion import check_held
from limbcli.fem.equilibrium.settings import Counts, Settings
from limbcli.fem.equilibrium.tangent import Inverse, Tangent, assemble
from limbcli.fem.linear_solvers import direct as linear_solvers
from limbcli.fem.linear_solvers.growing_pattern import GrowingPatternSolver
from limbcli.fem.linear_solvers.krylov import gmres
from limbcli.fem.linear_solvers.singular import singular
from limbcli.fem.motion.state import Forces, State, norm
from limbcli.fem.system import System
from limbcli.model import Array

# Bounds on the Krylov iterations per solve: the closer to incompressible, the more even a fresh factor needs.
_LEAST_KRYLOV, _MAX_KRYLOV = 30, 40
_OLD_KRYLOV = 1.5  # limit of Krylov iterations with an older factor, as a multiple of a factorisation's cost
_LARGE = 6_000  # number of equations above which a single-precision factor is faster overall
_FRESH = 2.0  # Krylov iterations per decade of residual reduction with a fresh factor
# Cost of a factorisation in Krylov iterations, per unit of `solves_per_factor` (0.2 to 1.0 tried).
_PER_SOLVE = 0.7
_OUTDATED = 0.4  # extra Krylov cost, in factorisations, above which a new factor is computed
_MEMORY = 0.5  # weight of the latest tangent in the running average `ageing`
_FORGETTING = 0.9  # decay of `ageing` per tangent at which no older factor was used
_ROUNDS = 8  # maximum number of contact updates (linear solves) in one Newton step
_OLD_ROUNDS = 2  # limit of Krylov iterations per Newton step with an older factor, in units of `patience`
_SPARED = 4  # increments begun with a new factor after one at which the older factor was given up
_NOWHERE = 0.999  # relative GMRES residual above which a matrix with an up-to-date factor counts as singular
_ROUGH = 0.1  # relative tolerance of the linear solve while the set of touching points changes


class Linearised:
    """Tangent and factor of one system, with cost estimates that decide when to refactor.

    reuse_cost : Krylov iterations that a fresh factor would have saved, in units of a factorisation: at 1
        keeping the old factor has cost as much as a new one
    ageing : running average of the extra cost per tangent of using an older factor, in the same unit; above
        1 no older factor is used (the closer to incompressible the tissue, the sooner a factor ages)
    rate : Krylov iterations per decade of the last solve
    stuck : the last linear solve did not converge: the factor is too old
    spared : number of increments to come that begin with a new factor, without a try with the older one
    drag : coefficient of the drag on the diagonal of the next tangents (see `relaxation.relax`)
    """

    def __init__(self, system: System, settings: Settings, counts: Counts):
        self.system, self.counts = system, counts
        self.tangent: Tangent | None = None
        self.inverse: Inverse | None = None
        self.reuse_cost = 0.0
        self.ageing = self._wasted = 0.0
        self.rate = _FRESH
        self.stuck, self.spared = False, 0
        self.drag = 0.0
        self.linear: Any = _solver(system, settings) if system.n_tissue else None

    def forget(self) -> None:
        """Discard tangent, factor and cost estimates."""
        self.tangent = self.inverse = None
        self.reuse_cost = self.ageing = self._wasted = 0.0
        self.rate, self.stuck, self.spared = _FRESH, False, 0

    @property
    def is_outdated(self) -> bool:
        """Whether a new factor should be computed: there is none, or the old one costs too much."""
        return self.inverse is None or self.reuse_cost > _OUTDATED or self.ageing > 1.0

    @property
    def per_factor(self) -> float:
        """Cost of a factorisation in Krylov iterations."""
        return _PER_SOLVE * float(self.linear.solves_per_factor) if self.linear is not None else 1.0

    @property
    def patience(self) -> int:
        """Maximum number of Krylov iterations per solve; beyond it a new factor is cheaper."""
        if self._is_old:
            return int(np.clip(_OLD_KRYLOV * self.per_factor, _LEAST_KRYLOV // 2, _MAX_KRYLOV))
        return int(np.clip(self.per_factor, _LEAST_KRYLOV, _MAX_KRYLOV))

    @property
    def _is_old(self) -> bool:
        """Whether the factor belongs to an earlier tangent."""
        return self.inverse is not None and self.inverse.tangent is not self.tangent

    def is_fresh(self, state: State) -> bool:
        """Whether tangent and factor are those of this state: another try would take the same steps."""
        return self.tangent is not None and self.tangent.state is state and not self._is_old

    def refresh(self, state: State, forces: Forces) -> None:
        """Assemble and factor the tangent at a state with these forces."""
        self.assemble(state, forces)
        self._factor(forces)

    def refactor(self, state: State, forces: Forces) -> None:
        """Factor the tangent at a state with these forces, assembled unless it is the last one."""
        if self.tangent is None or self.tangent.state is not state:
            self.assemble(state, forces)
        else:
            self._learn()
        self._factor(forces)

    def note_begun(self, *, too_old: bool) -> None:
        """Note whether the older factor was given up at the first step of an increment."""
        self.spared = _SPARED if too_old else max(self.spared - 1, 0)

    def _factor(self, forces: Forces) -> None:
        """Factor the tangent assembled last, at a state with these forces."""
        assert self.tangent is not None
        state = self.tangent.state
        if state.time == 0.0:
            check_held(self.tangent, forces.contact)
        self.inverse = Inverse(self.tangent, forces.contact, self.linear)
        if state.time == 0.0 and self.linear is not None:
            linear_solvers.check_supported(self.linear)
        self.counts.factorisations += 1
        self.reuse_cost, self.rate = 0.0, _FRESH

    def assemble(self, state: State, forces: Forces) -> None:
        """Assemble the tangent at a state with these forces; the factor is kept."""
        self._learn()
        self.tangent = assemble(self.system, state, forces.nodal, drag=self.drag)

    def _learn(self) -> None:
        """Update `ageing` with the factor's extra cost at the tangent that is about to be replaced."""
        if self._is_old:
            self.ageing += _MEMORY * (self._wasted - self.ageing)
        else:
            self.ageing *= _FORGETTING
        self._wasted = 0.0

    def ready_for(self, n_solves: int, decades: float, state: State, forces: Forces) -> None:
        """Assemble the exact tangent at a state, with a new factor if it pays off.

        n_solves, decades : number of solves to come, and residual reduction of each in decades
        """
        wasted = n_solves * decades * (self.rate - _FRESH)
        if self.inverse is None or wasted > self.per_factor:
            self.refresh(state, forces)
        elif self.tangent is None or self.tangent.state is not state:
            self.assemble(state, forces)

    def solve(self, contact: ContactState, rhs: Array, tolerance: float) -> Array:
        """Solve with the last assembled tissue tangent and the tangent of this contact.

        Raises SingularMatrix if GMRES does not reduce the residual although the factor is up to date.
        """
        assert self.tangent is not None
        assert self.inverse is not None
        tangent = self.tangent
        self.inverse.follow(contact)
        step, n, reached = gmres(
            lambda v: tangent.times(contact, v),
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
        self, base: State, tissue: Array, goal: float, contact: ContactState, *, first: Array | None = None,
        far: bool = False,
    ) -> tuple[Array, ContactState]:  # fmt: skip
        """Newton step from `base`: equilibrium of the linearised tissue with nonlinear contact.

        tissue : tissue part of the residual at `base`; it is extrapolated linearly
        goal : norm of the residual at which the iteration stops
        contact : at `base`, or with a first step at the state before
        first : initial step
        far : contact tractions are far from those at equilibrium (see `ContactState.full_tangent`)

        Contact is searched again after each linear solve: a semismooth Newton iteration (Hintermueller,
        Ito and Kunisch 2002, SIAM J. Optim. 13, 865-888) that needs no loop over the cells.
        Returns the step, and the contact found last.
        """
        system, tangent = self.system, self.tangent
        assert tangent is not None
        step, rough = np.zeros_like(tissue) if first is None else first, first is not None
        if rough:
            contact = system.search(system.moved(base, step), before=contact)
            tissue = tissue + tangent.tissue_times(step)
        residual = tissue + system.contact_residual(contact)
        best = np.inf, step
        most = self.counts.krylov + _OLD_ROUNDS * self.patience
        for k in range(_ROUNDS):
            size = norm(residual)
            if size <= goal:
                return step, contact
            relative = goal / size
            linear = replace(contact, full_tangent=not far)
            change = self.solve(linear, -residual, max(relative, _ROUGH) if rough else relative)
            moved, before = tangent.tissue_times(change), contact
            length, contact, residual = self._shortened(base, tissue, step, change, moved, size, before)
            step, tissue = step + length * change, tissue + length * moved
            if norm(residual) < best[0]:
                best = (norm(residual), step)
            elif k > 1:
                break
            self.stuck |= self._is_old and self.counts.krylov >= most
            if self.stuck:
                break
            rough = bool((before.touching != contact.touching).any())
        return best[1], contact

    def _shortened(
        self,
        base: State,
        tissue: Array,
        step: Array,
        change: Array,
        moved: Array,
        size: float,
        contact: ContactState,
    ) -> tuple[float, ContactState, Array]:
        """Line search: length, contact and residual of the first length that reduces the residual, else of
        the one with the smallest residual."""
        tried = []
        for length in (1.0, 0.5, 0.25):
            found = self.system.search(self.system.moved(base, step + length * change), before=contact)
            residual = tissue + length * moved + self.system.contact_residual(found)
            tried.append((length, found, residual))
            if norm(residual) < size:
                return tried[-1]
        return min(tried, key=lambda each: norm(each[2]))

    @property
    def n_unstable(self) -> int:
        """Number of negative pivots of the last tissue factor, i.e. of unstable modes."""
        return int(getattr(self.linear, "n_negative", 0))

    def close(self) -> None:
        if self.linear is not None:
            self.linear.close()


def _solver(system: System, settings: Settings) -> Any:
    pattern, single = system.pattern, settings.single
    make = partial(
        linear_solvers.make,
        kind=settings.linear,
        threads=settings.threads,
        single=single if single is not None else system.n_tissue > _LARGE,
        last=system.within_reach(),
    )
    if system.has_couplings:
        return GrowingPatternSolver(pattern.indptr, pattern.indices, make)
    return make(pattern.indptr, pattern.indices)
