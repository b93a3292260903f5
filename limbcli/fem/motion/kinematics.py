"""Kinematics of a model: equation numbers, prescribed values, load curves, rigid motions."""

from __future__ import annotations

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.motion import load_curves
from limbcli.fem.motion.rigid import AT_REST, DOFS, Body, BodyState, make_bodies, whole_rotation
from limbcli.fem.motion.state import State
from limbcli.model import Array, IntArray, LimbModel, NodeMap, Support
from limbcli.model.bodies import Drive

_AXES = {"x": 0, "y": 1, "z": 2}


class Kinematics:
    """The unknowns of a model in one analysis step, and the states they define.

    supports, drives : those active in this step (the model's and the step's own)
    coupled (n_points,) : nodes that belong to deformable cells
    start : state at the beginning of the step, the reference for relative loads
    """

    def __init__(
        self,
        model: LimbModel,
        supports: tuple[Support, ...] | None,
        drives: tuple[Drive, ...] | None,
        start: State | None,
        cells: list[IntArray],
    ):
        self.model = model
        self.X = np.ascontiguousarray(model.mesh.points, dtype=float)
        self.supports = model.supports if supports is None else supports
        self.drives = model.drives if drives is None else drives
        self.bodies = make_bodies(model, self.drives)
        self.start = start if start is not None else self.rest()
        self.time = self.start.time
        self.coupled = np.zeros(len(self.X), dtype=bool)
        for each in cells:
            self.coupled[each.ravel()] = True
        self._number_equations()

    def rest(self) -> State:
        return State(0.0, np.zeros_like(self.X), tuple(AT_REST for _ in self.model.bodies))

    def _number_equations(self) -> None:
        n = len(self.X)
        free = np.repeat(self.coupled[:, None], 3, axis=1)
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
        self._places = np.flatnonzero(free)
        self.rigid: list[tuple[int, int]] = [(b, k) for b, body in enumerate(self.bodies) for k in body.free]
        # the unknown of a turn is the way at this distance (mm), its residual the force there: moments (N mm)
        # beside forces would rule the residual's norm
        self.arms = np.array([1.0 if k < 3 else self._arm(b) for b, k in self.rigid])

    def _find_prescribed(self, free: Array) -> list[tuple[IntArray, int, Array, str | None, bool]]:
        """(nodes, axis, values, curve, relative) of every support; clears the constrained entries of `free`.

        If two supports act on one degree of freedom, a prescribed value takes precedence over a fixed one;
        otherwise the later support takes precedence.

        Source: FEBio, FEFixedBC::Activate, which fixes open degrees of freedom only.
        """
        found = []
        for each in sorted(self.supports, key=lambda support: support.value is not None):
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
                    self._refuse_rigid(nodes, each)
                    self._prescribed_values.append(found[-1])
        return found

    def _refuse_rigid(self, nodes: IntArray, support: Support) -> None:
        """Refuse prescribed displacements on nodes of a rigid body, as FEBio does."""
        for body in self.bodies:
            n = int(np.isin(nodes, [*body.tied, *body.points]).sum())
            if n:
                raise SolveError(
                    f"{n} nodes of {support.node_set!r} have a prescribed displacement and move with "
                    f"the rigid body {body.name!r}",
                    where="supports",
                    fix="remove them from the node set, or prescribe the body's motion",
                )

    def spread(self, x: Array) -> Array:
        """Scatter values (n_tissue,) of the tissue's unknowns to nodes (n_points, 3), 0 elsewhere."""
        out = np.zeros_like(self.X)
        out.ravel()[self._places] = x
        return out

    def collect(self, nodal: Array) -> Array:
        """Gather the values (n_tissue,) of the tissue's unknowns from nodal values (n_points, 3)."""
        return np.take(nodal.ravel(), self._places)

    @property
    def n_unknowns(self) -> int:
        return self.n_tissue + len(self.rigid)

    def curve_at(self, name: str, time: float) -> float:
        if name not in self.model.curves:
            raise SolveError(
                f"there is no load curve {name!r}",
                where="load curves",
                fix=f"use one of {list(self.model.curves)}",
            )
        return load_curves.value(self.model.curves[name], time)

    def curve(self, name: str) -> float:
        return self.curve_at(name, self.time)

    def prescribed(self, state: State, time: float) -> State:
        """The state with all prescribed values set to those at `time`; the unknowns are unchanged."""
        u = state.u.copy()
        for nodes, axis, values, curve, relative in self._prescribed:
            factor = 1.0 if curve is None else self.curve_at(curve, time)
            base = self.start.u[nodes, axis] if relative else 0.0
            u[nodes, axis] = base + values * factor
        bodies = [self._given(b, body, state, time) for b, body in enumerate(self.bodies)]
        after = State(time, u, tuple(bodies), state.hints, state.volumes)
        return self.followed(after)

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
        return BodyState(shift, self._rotation(body, now, begin, vector))

    def _rotation(self, body: Body, now: BodyState, begin: BodyState, vector: Array) -> Array:
        """The body's rotation vector.

        If all three components are given and at least one is prescribed, `vector` is the rotation vector,
        with 0 for fixed components; relative rotations are added to the rotation vector at the start of the
        step. If all are fixed, the rotation at the start of the step is kept.

        Source: FEBio, FERigidSolverNew::UpdateRigidBodies and FERigidPrescribedBC::Activate.
        """
        if not any(k >= 3 for k in body.free):
            given = [body.drives[dof] for dof in "uvw" if body.given(dof)]
            relative = {drive.relative for drive in given if drive.kind != "fixed"}
            if not relative:
                return begin.rotation
            if len(relative) > 1:
                raise SolveError(
                    f"body {body.name!r} has relative and absolute rotations together",
                    where="rigid bodies",
                    fix="make all of its rotations relative, or none",
                )
            given_vector = vector + begin.rotation if True in relative else vector
            return whole_rotation(given_vector, np.zeros(3))
        if vector.any():
            raise SolveError(
                f"body {body.name!r} has given and free rotations together",
                where="rigid bodies",
                fix="give all three rotations, or fix those that are not free",
            )
        return now.rotation

    def followed(self, state: State) -> State:
        """Place the tied nodes and the bodies' own nodes according to the bodies' motion (in place)."""
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
        return self.followed(State(state.time, u, tuple(bodies), state.hints))

    def _arm(self, b: int) -> float:
        """Root mean square distance (mm) of a body's nodes from its centre."""
        body = self.bodies[b]
        nodes = body.points if len(body.points) else body.tied
        size = float(np.sqrt(((self.X[nodes] - body.center) ** 2).sum(axis=1).mean())) if len(nodes) else 0.0
        return size or 1.0

    def motions(self, step: Array) -> Array:
        """The rigid-body part (n_bodies, 6) of a change of the unknowns."""
        out = np.zeros((len(self.bodies), 6))
        for k, (b, dof) in enumerate(self.rigid):
            out[b, dof] = step[self.n_tissue + k] / self.arms[k]
        return out

    def of_rigid(self, bodies: Array) -> Array:
        """The entries of the rigid unknowns in a residual, of forces and moments (n_bodies, 6)."""
        return np.array([bodies[k] for k in self.rigid]) / self.arms

    def center(self, b: int, state: State) -> Array:
        return self.bodies[b].center + state.bodies[b].shift

    def follow(self, state: State, motions: Array) -> Array:
        """Velocities (n_points, 3) of the tied nodes for body motions (n_bodies, 6)."""
        v = np.zeros_like(self.X)
        for b, body in enumerate(self.bodies):
            if len(body.tied) and motions[b].any():
                arm = self.X[body.tied] + state.u[body.tied] - self.center(b, state)
                v[body.tied] = motions[b, :3] + np.cross(motions[b, 3:], arm)
        return v
