"""The discretised model: equation numbering, sparsity pattern, forces and tangent.

The unknowns are the free displacements of the tissue's nodes, followed by the free degrees of
freedom of the rigid bodies. Nodes tied to a body move with it and have no equations of their own;
their part of the tangent enters as a few dense columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from itertools import islice

import numpy as np
import scipy.sparse as sparse

from limbcli.fem.contacts.contact import make_pairs, near_nodes
from limbcli.fem.contacts.contact_points import FACET, add_symmetric
from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.contacts.friction import FrictionPair
from limbcli.fem.contacts.patch import Patch
from limbcli.fem.elements.assembly import Pattern, Threads, make_pattern
from limbcli.fem.elements.element_loops import ElementLoops
from limbcli.fem.elements.groups import make_groups
from limbcli.fem.elements.thread_partition import halve
from limbcli.fem.motion.distributed_loads import DistributedLoads, LoadedSurface
from limbcli.fem.motion.rigid_loads import RigidLoads, moment
from limbcli.fem.motion.state import Forces, State
from limbcli.model import Array, IntArray, LimbModel, Load, Support
from limbcli.model.bodies import Drive

_NOTHING = 1e-9  # force regarded as zero, as a fraction of tissue stiffness times tissue size squared
# Unknowns that contact may change: as many can be in a front of their own, whose dense factor is then renewed
# alone. 4000 take 64 MB in single precision; more than a tenth of all (of a socket a third) cost as much as
# the whole factor, unless they are few.
_MOST_IN_ROOT, _SHARE_IN_ROOT, _FEW_IN_ROOT = 4_000, 0.1, 1_000


class System(RigidLoads, ElementLoops):
    """The equations of one analysis step of a model.

    supports, drives, loads : those active in this step (the model's and the step's own)
    start : state at the beginning of the step, the reference for relative loads
    """

    def __init__(
        self,
        model: LimbModel,
        *,
        supports: tuple[Support, ...] | None = None,
        drives: tuple[Drive, ...] | None = None,
        loads: tuple[Load, ...] | None = None,
        threads: int = 2,
        start: State | None = None,
    ):
        self.threads = Threads(threads)
        self.groups = make_groups(model)
        cell_lists = [g.cells for g in self.groups]
        super().__init__(model, supports, drives, start, cell_lists)
        self.pairs = make_pairs(model, self.groups, self.bodies)
        for pair in self.pairs:
            pair.threads = self.threads
        self.loads = model.loads if loads is None else loads
        self.distributed = DistributedLoads(model, self.loads, self.groups, self.bodies, self.X)
        patches = [p for pair in self.pairs for p in pair.patches]
        with_pairs: list[Patch | LoadedSurface] = [*patches, *self.distributed.surfaces]
        facets = [each.facets for each in with_pairs]
        self.pattern: Pattern = make_pattern(self.equations, cell_lists + facets)
        for each, pairs in zip(with_pairs, self.pattern.pairs[len(cell_lists) :], strict=True):
            each.pairs = pairs
        self.halves = [
            halve(self.X[cells].mean(axis=1), pairs, len(self.pattern.high))
            for cells, pairs in zip(cell_lists, self.pattern.pairs, strict=False)
        ]
        self._size = float(np.ptp(self.X[self.coupled], axis=0).max(initial=0.0)) if cell_lists else 0.0
        self.scales = [1.0] * len(self.groups)
        self.histories: list[Array] = [np.zeros((0, 1, 6))] * len(self.groups)
        self.at(self.start.time)
        self._set_penalties()

    @property
    def jumps(self) -> bool:
        """Whether a law's stress can be discontinuous (sheared fibres), making the tangent unsymmetric."""
        return any(each.jumps for each in self.operands)

    @property
    def least_force(self) -> float:
        """Force (N) regarded as zero in unloaded tissue: a generous bound on its stress round-off."""
        # lambda of a law without lateral contraction is 0
        moduli = [(float(abs(o.lame).max()), 2 * float(abs(o.shear).max())) for o in self.operands]
        stiffest = max((each for pair in moduli for each in pair), default=0.0)
        return _NOTHING * stiffest * self._size**2

    @property
    def drag(self) -> Array:
        """Nodal drag coefficients (n_points,), N/mm: shear modulus at rest x nodal volume / 1 mm^2."""
        out = np.zeros(len(self.X))
        for o in self.operands:
            share = np.broadcast_to(o.shear, len(o.cells)) * o.weight.sum(axis=1) / o.cells.shape[1]
            np.add.at(out, o.cells, share[:, None])
        return out

    # ------------------------------------------------------------ time

    def at(self, time: float) -> None:
        """Set the time and evaluate the material parameters that follow load curves."""
        self.time = time
        for pair in self.pairs:
            if pair.contact.penalty_curve is not None:
                pair.scale_penalty(self.curve_at(pair.contact.penalty_curve, time))
            if pair.contact.gap_tolerance_curve is not None:
                pair.looseness = self.curve_at(pair.contact.gap_tolerance_curve, time)
        self.distributed.at(self.curve, time)
        self.operands = [
            g.at(self.curve, scale=s, history=h)
            for g, s, h in zip(self.groups, self.scales, self.histories, strict=True)
        ]

    def with_materials(self, model: LimbModel) -> None:
        """Replace materials, load curves and steps on the same mesh, and update the contact penalty."""
        fresh = make_groups(replace(model, mesh=self.model.mesh)) if self._laws_differ(model) else None
        self.model = replace(self.model, materials=model.materials, curves=model.curves, steps=model.steps)
        if fresh is not None:
            self.groups = fresh
        self.at(self.start.time)
        self._set_penalties()

    def curve_at_first(self, name: str) -> float:
        """A load curve's value at time 0, at which contact penalties are evaluated."""
        return self.curve_at(name, 0.0)

    def _set_penalties(self) -> None:
        for pair in self.pairs:
            pair.set_penalty(self.groups, self.curve_at_first, self.model.steps[0].step_size)

    def begin(self) -> None:
        """Reset to the unloaded state; the histories of friction and of stresses are discarded."""
        self.start = self.rest()
        self.scales = [1.0] * len(self.groups)
        self.histories = [np.zeros((0, 1, 6))] * len(self.groups)
        for pair in self.pairs:
            pair.forget(self.X)
        self.at(0.0)

    def remember(self, state: State) -> None:
        """Store a converged state as the reference for friction, and for how deep a point can come."""
        for pair, hints in zip(self.pairs, self._hints_by_pair(state), strict=True):
            pair.remember(self.X + state.u, hints)

    def take_multipliers(self, before: System) -> None:
        """Copy the multipliers of the augmented contacts, and the gaps at the last converged step, from the
        system of the previous step."""
        for mine, theirs in zip(self.pairs, before.pairs, strict=True):
            mine.set_multipliers(theirs.multipliers())
            mine.past, mine.last_gaps = theirs.past, theirs.last_gaps

    def _laws_differ(self, model: LimbModel) -> bool:
        return any(model.materials[d.material] is not self.model.materials[d.material] for d in model.domains)

    # ------------------------------------------------------------ forces

    def forces(self, state: State, *, contact: ContactState | None = None) -> Forces:
        """Internal, contact, spring and applied forces at a state; loads are subtracted from `nodal`.

        contact : at the state; None: it is searched
        """
        nodal, worst, worst_cell = self.internal(state)
        internal = nodal.copy()
        touch = self.search(state) if contact is None else contact
        pressed, bodies = self.contact_forces(touch)
        loads = self.distributed.forces(state.u)
        nodal += pressed - loads
        self.gather_tied(state, nodal, bodies)
        self.add_springs(state, bodies)
        applied = self.applied(state.time)
        residual = np.concatenate([nodal[self.free], self.of_rigid(bodies - applied)])
        held = internal[~self.free]
        with np.errstate(over="ignore"):  # a diverging iterate may overflow
            acting = (held, pressed, applied[:, :3], loads)
            scale = np.sqrt(sum((each**2).sum() for each in acting))
        scale = max(float(scale), self.least_force)
        iterated = residual
        if state.volumes:
            iterated = residual.copy()
            iterated[: self.n_tissue] += self.volume_force(state)[self.free]
        return Forces(nodal, bodies, residual, scale, touch, worst, worst_cell, iterated)

    # ------------------------------------------------------------ tangent

    def stiffness(self, state: State) -> Array:
        """Blocks of the symmetric part of the elastic tangent (see `ElementLoops`) and of the loads' one."""
        blocks = super().stiffness(state)
        self.distributed.subtract_symmetric(state.u, blocks)
        return blocks

    def tangent_times(self, state: State, v: Array) -> Array:
        """Tangent of all nodes, elastic and of the loads, times v (n_points, 3)."""
        return super().tangent_times(state, v) - self.distributed.change(state.u, v)

    # ------------------------------------------------------------ contact

    def search(self, state: State, *, before: ContactState | None = None) -> ContactState:
        """The contact at a state; the search begins at the hints of the state, or of the contact before."""
        found, hints, n_touching = [], [], 0
        begins = self._hints_by_pair(state if before is None else before.state)
        earlier = before.points if before is not None else [()] * len(self.pairs)
        for pair, begin, old in zip(self.pairs, begins, earlier, strict=True):
            points, n = pair.search(self.X + state.u, begin, old)
            found.append(points)
            hints += [each[..., FACET].copy() for each in points]
            n_touching += n
        return ContactState(replace(state, hints=tuple(hints), volumes=()), tuple(found), n_touching)

    def _hints_by_pair(self, state: State) -> list[tuple[Array, ...]]:
        hints = iter(state.hints)
        return [tuple(islice(hints, len(pair.patches))) for pair in self.pairs]

    def contact_forces(self, contact: ContactState) -> tuple[Array, Array]:
        """Contact's forces on the nodes (n_points, 3), and what holds the bodies against it (n_bodies, 6)."""
        nodal, bodies = self._contact_nodal(contact), np.zeros((len(self.bodies), 6))
        self.gather_touched(contact.state, nodal, bodies)
        return nodal, bodies

    def _contact_nodal(self, contact: ContactState) -> Array:
        """Contact's forces (n_points, 3) on the nodes of both sides."""
        nodal = np.zeros_like(self.X)
        for pair, found in zip(self.pairs, contact.points, strict=True):
            pair.force(found, nodal)
        return nodal

    @property
    def first_touched(self) -> int:
        """Number of the body that the first contact with one has, or else of the first body."""
        return next((pair.body for pair in self.pairs if pair.body is not None), 0)

    def gather_touched(self, state: State, nodal: Array, bodies: Array) -> None:
        """Move forces on the nodes of the bodies that touch to the bodies' forces and moments."""
        for b, nodes, arm in self._touched_bodies(state):
            bodies[b, :3] += nodal[nodes].sum(axis=0)
            bodies[b, 3:] += moment(arm, nodal[nodes])
            nodal[nodes] = 0.0

    def _touched_bodies(self, state: State) -> Iterator[tuple[int, IntArray, Array]]:
        """The bodies on the secondary side: number, their nodes there, and these nodes' lever arms."""
        for b, nodes in self._secondary_nodes.items():
            yield b, nodes, self.X[nodes] + state.u[nodes] - self.center(b, state)

    @cached_property
    def _secondary_nodes(self) -> dict[int, IntArray]:
        """Nodes of every body on the secondary side of a contact, by the body's number."""
        facets: dict[int, list[IntArray]] = {}
        for pair in self.pairs:
            if pair.body is not None:
                facets.setdefault(pair.body, []).append(pair.facets2[pair.facets2 >= 0])
        return {b: np.unique(np.concatenate(each)) for b, each in sorted(facets.items())}

    def contact_rows(self, contact: ContactState) -> Array:
        """The rigid unknowns' rows of the contact tangent (n_rigid, n_tissue).

        With friction the moments are approximate: the force on the wall is taken to act where the skin is, a
        penetration beside the wall.
        """
        x = self.X + contact.state.u
        nodal = np.zeros((len(self.rigid), *x.shape))
        for pair, found in zip(self.pairs, contact.points, strict=True):
            mine = [(r, dof) for r, (b, dof) in enumerate(self.rigid) if b == pair.body]
            if pair.body is None or not mine:
                continue
            arm, pressed = x - self.center(pair.body, contact.state), np.zeros_like(x)
            if contact.full_tangent:
                pair.force(found, pressed)
            parts = []
            for k, patch in enumerate(pair.patches):
                blocks, touched = pair.blocks(k, found[k], x, full=contact.full_tangent)
                parts.append((patch.facets[touched], blocks[touched]))
            for r, dof in mine:
                along = np.eye(3)[dof % 3] / self.arms[r]
                ways = np.cross(along, arm) if dof >= 3 else np.broadcast_to(along, x.shape)
                for nodes, blocks in parts:
                    np.subtract.at(nodal[r], nodes, np.einsum("fai,faibj->fbj", ways[nodes], blocks))
                if dof >= 3:  # the arms change with the skin; what the body's own nodes have is not collected
                    nodal[r] += np.cross(along, pressed)
        return np.array([self.collect(each) for each in nodal]).reshape(-1, self.n_tissue)

    def contact_residual(self, contact: ContactState) -> Array:
        """The contact part of the residual."""
        if not self.rigid:  # what the bodies take is of no interest
            return self.collect(self._contact_nodal(contact))
        nodal, bodies = self.contact_forces(contact)
        self.gather_tied(contact.state, nodal, bodies)
        return np.concatenate([nodal[self.free], self.of_rigid(bodies)])

    def add_contact(self, contact: ContactState, values: Array, *, couples: bool = True) -> Array:
        """A copy of the matrix values with the symmetric part of the contact tangent added, except for what
        `couplings` hold.

        couples : see `Pair.blocks`
        """
        values, x = values.copy(), self.X + contact.state.u
        for pair, found in zip(self.pairs, contact.points, strict=True):
            for k, patch in enumerate(pair.patches if pair.body is not None else ()):
                blocks, touched = pair.blocks(k, found[k], x, full=contact.full_tangent, couples=couples)
                add_symmetric(blocks, touched, patch.pairs, self.pattern.slots, values)
        return values

    @property
    def has_couplings(self) -> bool:
        """Whether contact couples soft surfaces, nodes that share no cell."""
        return any(pair.body is None for pair in self.pairs)

    def couplings(self, contact: ContactState, *, couples: bool = True) -> sparse.csr_array:
        """Symmetric part of the contact tangent (n_tissue, n_tissue) between soft surfaces."""
        rows = self.equations
        soft = self.contact_matrix(contact, rows, self.n_tissue, couples=couples, rigid=False)
        return 0.5 * (soft + soft.T)

    def contact_matrix(
        self, contact: ContactState, rows: IntArray, n: int, *, couples: bool = True, rigid: bool = True
    ) -> sparse.csr_array:
        """Contact tangent (n, n) for a subset of the unknowns.

        rows (n_points, 3) : row of each degree of freedom in the result; -1 leaves it out
        couples : see `Pair.blocks`
        rigid : False leaves out contact with rigid bodies
        """
        x, options = self.X + contact.state.u, {"full": contact.full_tangent, "couples": couples}
        parts = [(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))]
        for pair, found in zip(self.pairs, contact.points, strict=True):
            for k, patch in enumerate(pair.patches if rigid or pair.body is None else ()):
                if isinstance(pair, FrictionPair) and pair.body is None:
                    nodes, blocks = pair.both_blocks(k, found[k], x, **options)
                else:
                    blocks, touched = pair.blocks(k, found[k], x, **options)
                    nodes, blocks = patch.facets[touched], blocks[touched]
                size = 3 * nodes.shape[1]
                mine = np.where((nodes >= 0)[..., None], rows[nodes], -1).reshape(-1, size)
                values = blocks.reshape(-1, size, size)
                row, column = np.broadcast_arrays(mine[:, :, None], mine[:, None, :])
                inside = (row >= 0) & (column >= 0)
                parts.append((values[inside], row[inside], column[inside]))
        values, row, column = (np.concatenate(each) for each in zip(*parts, strict=True))
        return sparse.coo_array((values, (row, column)), shape=(n, n)).tocsr()

    def within_reach(self) -> IntArray:
        """Sorted equation numbers of the nodes that the rigid surfaces may touch during this step.

        Empty where they are too many to be eliminated together, or too large a part of all, as in a socket
        around a whole limb.
        """
        nodes = [
            near_nodes(self.X, pair.facets2, patch.facets, patch.normals)
            for pair in self.pairs
            if pair.body is not None
            for patch in pair.patches
        ]
        found = self.equations[np.concatenate(nodes)].ravel() if nodes else np.zeros(0, dtype=np.int64)
        found = np.unique(found[found >= 0])
        most = min(max(_SHARE_IN_ROOT * self.n_tissue, _FEW_IN_ROOT), _MOST_IN_ROOT)
        return found if len(found) <= most else found[:0]

    def may_pass(self, state: State, time: float) -> bool:
        """Whether a secondary surface not in contact at a converged state would move by more than the contact
        search radius until `time`, so that it could pass through the skin undetected."""
        ways = np.linalg.norm(self.prescribed(state, time).u - state.u, axis=1)
        for pair, hints in zip(self.pairs, self._hints_by_pair(state), strict=True):
            rigid = ways[pair.facets2[pair.facets2 >= 0]]
            touches = any((each >= 0).any() for each in hints)
            if not touches and rigid.max(initial=0.0) > pair.contact.search_radius:
                return True
        return False

    def contact_times(self, contact: ContactState, v: Array, motions: Array) -> tuple[Array, Array]:
        """Contact tangent times nodal and body motions.

        Returns forces on the nodes (n_points, 3) and on the bodies (n_bodies, 6).
        """
        nodal, bodies = self._contact_rates(contact, v, motions), np.zeros((len(self.bodies), 6))
        if contact.full_tangent and motions[:, 3:].any():
            forces = self._contact_nodal(contact)
            for b, nodes, arm in self._touched_bodies(contact.state):
                bodies[b, 3:] += moment(np.cross(motions[b, 3:], arm), forces[nodes])
        self.gather_touched(contact.state, nodal, bodies)
        return nodal, bodies

    def _contact_rates(self, contact: ContactState, v: Array, motions: Array) -> Array:
        """Contact tangent times nodal and body motions: forces (n_points, 3) on the nodes of both sides."""
        nodal, state, v = np.zeros_like(self.X), contact.state, v.copy()
        for nodes in self._secondary_nodes.values():
            v[nodes] = 0.0
        for b, nodes, arm in self._touched_bodies(state) if motions.any() else ():
            v[nodes] = motions[b, :3] + np.cross(motions[b, 3:], arm)
        for pair, found in zip(self.pairs, contact.points, strict=True):
            pair.times(found, self.X + state.u, v, nodal, full=contact.full_tangent)
        return nodal

    def contact_change(
        self, contact: ContactState, step: Array | None = None, *, motions: Array | None = None
    ) -> Array:
        """Contact tangent times a change of the unknowns.

        motions (n_bodies, 6) : additional prescribed motions of the bodies
        """
        step = np.zeros(self.n_unknowns) if step is None else step
        out = np.zeros_like(step)
        if not self.pairs:
            return out
        n = self.n_tissue
        own = self.motions(step)
        v = self.follow(contact.state, own) + self.spread(step[:n])
        motions = own if motions is None else own + motions
        if not self.rigid:  # what the bodies take is of no interest
            out[:] = self.collect(self._contact_rates(contact, v, motions))
            return out
        nodal, bodies = self.contact_times(contact, v, motions)
        out[:n] = self.collect(nodal)
        out[n:] = self.of_rigid(bodies)
        return out

    def close(self) -> None:
        self.threads.close()
