"""A model made ready for computing: equations, pattern, forces, tangent.

Unknowns are the free displacements of the tissue's nodes and the free degrees of
freedom of the rigid bodies, in this order. Nodes tied to a body follow it and have no
equations; their part of the tangent enters as a few dense columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem import curves, kernels
from limbcli.fem.assembly import Pattern, Threads, make_pattern
from limbcli.fem.contact import make_pairs
from limbcli.fem.contact_kernels import FACET, TRACTION
from limbcli.fem.groups import Group, Operands, make_groups
from limbcli.fem.rigid import (
    AT_REST,
    DOFS,
    Body,
    BodyState,
    make_bodies,
    rotation_matrix,
    skew,
    spring_forces,
)
from limbcli.model import Array, Drive, IntArray, LimbModel, NodeMap, Support

_NO_VOLUMES = np.zeros((0, 1))
_NO_TRACTIONS = np.zeros((0, 1))
_NOTHING = 1e-9  # of the tissue's stiffness times the square of its size
_AXES = {"x": 0, "y": 1, "z": 2}


def norm(v: Array) -> float:
    """Euclidean norm; waking the threads of a BLAS costs more than this sum."""
    return float(np.sqrt(np.einsum("i,i", v, v)))


@dataclass(frozen=True, eq=False)
class State:
    """Displacements u (n_points, 3) of all nodes, where the bodies are, and (where converged) what
    rigid facets the contact points are with.

    volumes : volume ratios (n_cells, n_gauss) of each group that pressures are taken at on the way to
        equilibrium; empty: those of u, as at equilibrium
    tractions : contact tractions (n_facets, n_gauss) of each patch, likewise
    """

    time: float
    u: Array
    bodies: tuple[BodyState, ...]
    hints: tuple[Array, ...] = ()
    volumes: tuple[Array, ...] = ()
    tractions: tuple[Array, ...] = ()


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


class System:
    """The equations of one analysis step of a model.

    supports, drives : those in force (the model's and the step's)
    start : state at the beginning of the step, for relative loads
    """

    def __init__(
        self,
        model: LimbModel,
        *,
        supports: tuple[Support, ...] | None = None,
        drives: tuple[Drive, ...] | None = None,
        threads: int = 2,
        start: State | None = None,
    ):
        self.model = model
        self.X = np.ascontiguousarray(model.mesh.points, dtype=float)
        self.supports = model.supports if supports is None else supports
        self.drives = model.drives if drives is None else drives
        self.threads = Threads(threads)
        self.groups = make_groups(model)
        self.bodies = make_bodies(model, self.drives)
        self.pairs = make_pairs(model, self.groups, self.bodies)
        self.start = start if start is not None else self.rest()
        self._number_equations()
        cell_lists = [g.cells for g in self.groups]
        patches = [p for pair in self.pairs for p in pair.patches]
        self.pattern: Pattern = make_pattern(self.equations, cell_lists + [p.facets for p in patches])
        for patch, pairs in zip(patches, self.pattern.pairs[len(cell_lists) :], strict=True):
            patch.pairs = pairs
        self.scales = [1.0] * len(self.groups)
        self.histories: list[Array] = [np.zeros((0, 1, 6))] * len(self.groups)
        self.operands: list[Operands] = []
        self.at(self.start.time)
        self._set_penalties()
        self._size = float(np.ptp(self.X[self._coupled], axis=0).max()) if self._coupled.any() else 0.0

    # ------------------------------------------------------------ set-up

    def rest(self) -> State:
        return State(0.0, np.zeros_like(self.X), tuple(AT_REST for _ in self.model.bodies))

    def _number_equations(self) -> None:
        n = len(self.X)
        used = np.zeros(n, dtype=bool)
        for group in self.groups:
            used[group.cells.ravel()] = True
        self._coupled = used
        free = np.repeat(used[:, None], 3, axis=1)
        self.tied = np.zeros(n, dtype=bool)
        for body in self.bodies:
            self.tied[body.tied] = True
        free[self.tied] = False
        self._prescribed_values: list[tuple[IntArray, int, Array, str | None, bool]] = []
        self._prescribed = self._find_prescribed(free)
        self.driven = np.zeros((n, 3), dtype=bool)
        for nodes, axis, _, _, _ in self._prescribed_values:
            self.driven[nodes, axis] = True
        self.equations = np.full((n, 3), -1, dtype=np.int64)
        self.n_tissue = int(free.sum())
        self.equations[free] = np.arange(self.n_tissue)
        self.free = free
        self.rigid: list[tuple[int, int]] = [(b, k) for b, body in enumerate(self.bodies) for k in body.free]
        if self.n_tissue + len(self.rigid) == 0:
            self.n_tissue = 0

    def _find_prescribed(self, free: Array) -> list[tuple[IntArray, int, Array, str | None, bool]]:
        """(nodes, axis, values, curve, relative) of every support with a value; frees are cleared."""
        found = []
        for each in self.supports:
            if each.node_set not in self.model.mesh.node_sets:
                raise SolveError(
                    f"a support refers to the unknown node set {each.node_set!r}",
                    where="supports",
                    fix=f"use one of {sorted(self.model.mesh.node_sets)}",
                )
            nodes = np.asarray(self.model.mesh.node_sets[each.node_set], dtype=np.int64)
            for dof in each.dofs:
                if dof not in _AXES:
                    raise SolveError(
                        f"a support on {dof!r} (fluid pressure) is not supported",
                        where=f"node set {each.node_set!r}",
                        fix="run FEBio for biphasic models",
                    )
                free[nodes, _AXES[dof]] = False
                value = each.value.values if isinstance(each.value, NodeMap) else each.value
                values = np.broadcast_to(
                    np.asarray(0.0 if value is None else value, dtype=float), nodes.shape
                )
                found.append((nodes, _AXES[dof], values, each.curve, each.relative))
                if value is not None:
                    self._prescribed_values.append(found[-1])
        return found

    @property
    def jumps(self) -> bool:
        """Whether a stress jumps (sheared fibres), so that the tangent is not symmetric."""
        return any(each.jumps for each in self.operands)

    @property
    def least_force(self) -> float:
        """What counts as no force (N), where nothing loads the tissue: round-off of its stresses, amply."""
        stiffest = max((float(abs(o.lame).max()) for o in self.operands), default=0.0)
        return _NOTHING * stiffest * self._size**2

    @property
    def n_unknowns(self) -> int:
        return self.n_tissue + len(self.rigid)

    # ------------------------------------------------------------ time

    def curve_at(self, name: str, time: float) -> float:
        if name not in self.model.curves:
            raise SolveError(
                f"there is no load curve {name!r}",
                where="load curves",
                fix=f"use one of {list(self.model.curves)}",
            )
        return curves.value(self.model.curves[name], time)

    def curve(self, name: str) -> float:
        return self.curve_at(name, self.time)

    def at(self, time: float) -> None:
        """Set the time: material numbers that follow load curves are evaluated."""
        self.time = time
        self.operands = [
            g.at(self.curve, scale=s, history=h)
            for g, s, h in zip(self.groups, self.scales, self.histories, strict=True)
        ]

    def with_materials(self, model: LimbModel) -> None:
        """Take other material parameters on the same mesh; the penalty follows them."""
        fresh = make_groups(replace(model, mesh=self.model.mesh)) if self._laws_differ(model) else None
        self.model = replace(self.model, materials=model.materials, curves=model.curves)
        if fresh is not None:
            self.groups = fresh
        self.at(self.start.time)
        self._set_penalties()

    def _set_penalties(self) -> None:
        for pair in self.pairs:
            pair.set_penalty(self.groups, self.curve, self.model.steps[0].step_size)

    def begin(self) -> None:
        """Back to before any load: contact and history forgotten."""
        self.start = self.rest()
        self.scales = [1.0] * len(self.groups)
        self.histories = [np.zeros((0, 1, 6))] * len(self.groups)
        for pair in self.pairs:
            pair.forget()
        self.at(0.0)

    def remember(self, state: State) -> None:
        """Take a converged step over as the one that friction is measured from."""
        self.recall(state.hints)
        for pair in self.pairs:
            pair.remember(self.X + state.u, state.bodies[pair.body])

    def hints(self) -> tuple[Array, ...]:
        """The rigid facet that every contact point is with."""
        return tuple(p.state[..., FACET].copy() for pair in self.pairs for p in pair.patches)

    def recall(self, hints: tuple[Array, ...]) -> None:
        patches = [p for pair in self.pairs for p in pair.patches]
        for patch, hint in zip(patches, hints, strict=False):
            patch.state[..., FACET] = hint

    def _laws_differ(self, model: LimbModel) -> bool:
        return any(model.materials[d.material] is not self.model.materials[d.material] for d in model.domains)

    def prescribed(self, state: State, time: float) -> State:
        """The state with everything that is given moved to `time`; all else as it was."""
        u = state.u.copy()
        for nodes, axis, values, curve, relative in self._prescribed:
            factor = 1.0 if curve is None else self.curve_at(curve, time)
            base = self.start.u[nodes, axis] if relative else 0.0
            u[nodes, axis] = base + values * factor
        bodies = [self._given(b, body, state, time) for b, body in enumerate(self.bodies)]
        after = State(time, u, tuple(bodies), state.hints, state.volumes, state.tractions)
        return self._followed(after)

    def _given(self, b: int, body: Body, state: State, time: float) -> BodyState:
        now, begin = state.bodies[b], self.start.bodies[b]
        shift, vector = now.shift.copy(), np.zeros(3)
        for k, dof in enumerate(DOFS):
            if not body.given(dof):
                continue
            drive = body.drives[dof]
            value = 0.0
            if drive.kind != "fixed":
                value = drive.value * (1.0 if drive.curve is None else self.curve_at(drive.curve, time))
            if k < 3:
                held = begin.shift[k] if drive.kind == "fixed" or drive.relative else 0.0
                shift[k] = held + value
            else:
                vector[k - 3] = value
        return BodyState(shift, self._turn(body, now, begin, vector))

    def _turn(self, body: Body, now: BodyState, begin: BodyState, vector: Array) -> Array:
        if not any(k >= 3 for k in body.free):
            moving = [body.drives[d] for d in "uvw" if d in body.drives and body.drives[d].kind != "fixed"]
            if not moving:
                return begin.turn
            return rotation_matrix(vector) @ (begin.turn if moving[0].relative else np.eye(3))
        if vector.any():
            raise SolveError(
                f"body {body.name!r} has given and free rotations together",
                where="rigid bodies",
                fix="give all three rotations, or fix those that are not free",
            )
        return now.turn

    def _followed(self, state: State) -> State:
        """Tied nodes and the bodies' own points put where the bodies are."""
        for body, at in zip(self.bodies, state.bodies, strict=True):
            for nodes in (body.tied, body.points):
                if len(nodes):
                    state.u[nodes] = at.place(self.X[nodes], body.center) - self.X[nodes]
        return state

    def moved(self, state: State, step: Array) -> State:
        """The state after a change of the unknowns."""
        u = state.u.copy()
        u[self.free] += step[: self.n_tissue]
        bodies = list(state.bodies)
        motions = self.motions(step)
        for b in {b for b, _ in self.rigid}:
            bodies[b] = bodies[b].moved(motions[b])
        return self._followed(State(state.time, u, tuple(bodies)))

    def motions(self, step: Array) -> Array:
        """Motions (n_bodies, 6) contained in a change of the unknowns."""
        out = np.zeros((len(self.bodies), 6))
        for k, (b, dof) in enumerate(self.rigid):
            out[b, dof] = step[self.n_tissue + k]
        return out

    def center(self, b: int, state: State) -> Array:
        return self.bodies[b].center + state.bodies[b].shift

    # ------------------------------------------------------------ forces

    def forces(self, state: State) -> Forces:
        """Internal, contact, spring and applied forces at a state."""
        nodal, worst, place = self.internal(state)
        internal = nodal.copy()
        bodies = np.zeros((len(self.bodies), 6))
        touching = 0
        contact = np.zeros_like(nodal)
        x = self.X + state.u
        for pair in self.pairs:
            touching += pair.search(x, state.bodies[pair.body])
            push = np.zeros(6)
            pair.force(self.center(pair.body, state), contact, push)
            bodies[pair.body] -= push
        nodal += contact
        self.gather_tied(state, nodal, bodies)
        self._add_springs(state, bodies)
        applied = self._applied(state.time)
        residual = np.concatenate([nodal[self.free], [bodies[k] - applied[k] for k in self.rigid]])
        held = internal[~self.free]
        with np.errstate(over="ignore"):  # of a step far astray
            scale = np.sqrt((held**2).sum() + (contact**2).sum() + (applied[:, :3] ** 2).sum())
        scale = max(float(scale), self.least_force)
        mixed = residual
        if state.volumes or state.tractions:
            shift = self.volume_force(state) if state.volumes else np.zeros_like(nodal)
            if state.tractions:
                for k, pair in enumerate(self.pairs):
                    pair.shifted_force(self._carried(state, k), shift)
            mixed = residual.copy()
            mixed[: self.n_tissue] += shift[self.free]
        return Forces(nodal, bodies, residual, scale, touching, worst, place, mixed)

    def internal(self, state: State) -> tuple[Array, float, tuple[int, int]]:
        """Internal nodal forces, smallest det F and where."""
        parts = [np.zeros_like(self.X) for _ in range(self.threads.n)]
        worst, place = np.inf, (-1, -1)
        for k, o in enumerate(self.operands):
            args = o.arguments()

            def task(worker: int, begin: int, end: int, args: Any = args) -> tuple[float, int]:
                return kernels.internal_force(begin, end, state.u, *args, parts[worker])  # type: ignore[no-any-return]

            low, cell = min(self.threads.run(task, len(o.cells)))
            if low < worst:
                worst, place = low, (k, cell)
        total = parts[0]
        for each in parts[1:]:
            total += each
        return total, worst, place

    def linear_volumes(self, state: State, v: Array) -> tuple[Array, ...]:
        """det F of every group (n_cells, n_gauss), plus its linear change along v (n_points, 3)."""
        out = tuple(np.empty(o.weight.shape) for o in self.operands)
        for o, J in zip(self.operands, out, strict=True):
            args = (o.cells, o.grad, o.base, J)

            def task(worker: int, begin: int, end: int, args: Any = args) -> None:
                kernels.linear_volumes(begin, end, state.u, v, *args)

            self.threads.run(task, len(o.cells))
        return out

    def volume_force(self, state: State) -> Array:
        """What pressures at the state's own volume ratios add to the internal forces (n_points, 3)."""
        parts = [np.zeros_like(self.X) for _ in range(self.threads.n)]
        for o, volumes in zip(self.operands, state.volumes, strict=True):
            args = (o.cells, o.grad, o.weight, o.base, o.lame, volumes)

            def task(worker: int, begin: int, end: int, args: Any = args) -> None:
                kernels.volume_force(begin, end, state.u, *args, parts[worker])

            self.threads.run(task, len(o.cells))
        for each in parts[1:]:
            parts[0] += each
        return parts[0]

    def gather_tied(self, state: State, nodal: Array, bodies: Array) -> None:
        """Add the forces of nodes that are tied to a body to the body's forces and moments."""
        for b, body in enumerate(self.bodies):
            if len(body.tied):
                f = nodal[body.tied]
                arm = self.X[body.tied] + state.u[body.tied] - self.center(b, state)
                bodies[b, :3] += f.sum(axis=0)
                bodies[b, 3:] += np.cross(arm, f).sum(axis=0)

    def _add_springs(self, state: State, bodies: Array) -> None:
        index = {body.name: b for b, body in enumerate(self.bodies)}
        both = {body.name: (body, state.bodies[b]) for b, body in enumerate(self.bodies)}
        for spring in self.model.springs:
            on_a, on_b, _ = spring_forces(spring, both)
            bodies[index[spring.body_a]] -= on_a
            bodies[index[spring.body_b]] -= on_b

    def _applied(self, time: float) -> Array:
        out = np.zeros((len(self.bodies), 6))
        for b, body in enumerate(self.bodies):
            for k, dof in enumerate(DOFS):
                drive = body.drives.get(dof)
                if drive is not None and drive.kind in ("force", "moment"):
                    out[b, k] = drive.value * (
                        1.0 if drive.curve is None else self.curve_at(drive.curve, time)
                    )
        return out

    # ------------------------------------------------------------ tangent

    def stiffness(self, state: State) -> Array:
        """Upper triangle of the elastic tangent of the tissue's unknowns (without contact), its symmetric
        part."""
        parts = [np.zeros(len(self.pattern.indices)) for _ in range(self.threads.n)]
        for k, (o, pairs) in enumerate(zip(self.operands, self.pattern.pairs, strict=False)):
            args = (*o.arguments(), *self._mixed(state, k), pairs, self.pattern.slots)

            def task(worker: int, begin: int, end: int, args: Any = args) -> None:
                kernels.tangent(begin, end, state.u, *args, parts[worker])

            self.threads.run(task, len(o.cells))
        for each in parts[1:]:
            parts[0] += each
        return parts[0]

    def _mixed(self, state: State, group: int) -> tuple[Array, Array]:
        volumes = state.volumes[group] if state.volumes else _NO_VOLUMES
        return self.operands[group].lame, volumes

    def _carried(self, state: State, pair: int) -> Sequence[Array]:
        """The state's own tractions of the patches of one pair."""
        begin = sum(len(each.patches) for each in self.pairs[:pair])
        n = len(self.pairs[pair].patches)
        return state.tractions[begin : begin + n] if state.tractions else [_NO_TRACTIONS] * n

    def tractions(self) -> tuple[Array, ...]:
        """Contact tractions (n_facets, n_gauss) of each patch as searched last."""
        return tuple(p.state[..., TRACTION].copy() for pair in self.pairs for p in pair.patches)

    def linear_tractions(self, state: State, v: Array, motions: Array) -> tuple[Array, ...]:
        """The tractions as searched last, changed linearly along nodal and body motions."""
        x = self.X + state.u
        return tuple(
            each
            for k, pair in enumerate(self.pairs)
            for each in pair.linear_tractions(x, v, motions[pair.body], self._carried(state, k))
        )

    def add_contact(self, state: State, values: Array) -> Array:
        """The matrix with the symmetric part of the contact (as searched last) added."""
        values = values.copy()
        for k, pair in enumerate(self.pairs):
            pair.stiffness(self.X + state.u, self._carried(state, k), self.pattern.slots, values)
        return values

    def tangent_times(self, state: State, v: Array) -> Array:
        """Elastic tangent of all nodes times v (n_points, 3); with the slope of a stress that jumps."""
        parts = [np.zeros_like(self.X) for _ in range(self.threads.n)]
        for k, o in enumerate(self.operands):
            args = (*o.sloped().arguments(), *self._mixed(state, k))

            def task(worker: int, begin: int, end: int, args: Any = args) -> None:
                kernels.tangent_times(begin, end, state.u, *args, v, parts[worker])

            self.threads.run(task, len(o.cells))
        for each in parts[1:]:
            parts[0] += each
        return parts[0]

    def contact_times(self, state: State, v: Array, motions: Array) -> tuple[Array, Array]:
        """Exact contact tangent times nodal and body motions: nodal (n_points, 3), bodies (n_bodies, 6)."""
        nodal, bodies = np.zeros_like(self.X), np.zeros((len(self.bodies), 6))
        x = self.X + state.u
        for k, pair in enumerate(self.pairs):
            body = np.zeros(6)
            carried = self._carried(state, k)
            pair.times(x, self.center(pair.body, state), v, motions[pair.body], carried, nodal, body)
            bodies[pair.body] -= body
        return nodal, bodies

    def spring_stiffness(self, state: State) -> Array:
        """Tangent (6 n_bodies, 6 n_bodies) of the springs."""
        index = {body.name: b for b, body in enumerate(self.bodies)}
        both = {body.name: (body, state.bodies[b]) for b, body in enumerate(self.bodies)}
        out = np.zeros((6 * len(self.bodies), 6 * len(self.bodies)))
        for spring in self.model.springs:
            a, b = index[spring.body_a], index[spring.body_b]
            rows = np.concatenate([np.arange(6 * a, 6 * a + 6), np.arange(6 * b, 6 * b + 6)])
            out[np.ix_(rows, rows)] += spring_forces(spring, both)[2]
        return out

    def follow(self, state: State, motions: Array) -> Array:
        """Velocities (n_points, 3) of tied nodes for motions (n_bodies, 6)."""
        v = np.zeros_like(self.X)
        for b, body in enumerate(self.bodies):
            if len(body.tied) and motions[b].any():
                arm = self.X[body.tied] + state.u[body.tied] - self.center(b, state)
                v[body.tied] = motions[b, :3] + np.cross(motions[b, 3:], arm)
        return v

    def tied_turning(self, state: State, nodal: Array, b: int) -> Array:
        """(3, 3): how the moment of the tied nodes' forces changes as their arms turn with the body."""
        body = self.bodies[b]
        arm = self.X[body.tied] + state.u[body.tied] - self.center(b, state)
        return sum(
            (-skew(f) @ -skew(a) for f, a in zip(nodal[body.tied], arm, strict=True)), np.zeros((3, 3))
        )

    def close(self) -> None:
        self.threads.close()


def group_of(groups: list[Group], block: str) -> int:
    """Number of the group of a block."""
    return next(k for k, g in enumerate(groups) if g.block == block)
