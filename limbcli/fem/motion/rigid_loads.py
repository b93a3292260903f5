"""Forces on rigid bodies: from tied nodes, from springs, and applied loads."""

from __future__ import annotations

import numpy as np

from limbcli.fem.motion.kinematics import Kinematics
from limbcli.fem.motion.rigid import DOFS, skew, spring_forces
from limbcli.fem.motion.state import State
from limbcli.model import Array


def moment(arms: Array, forces: Array) -> Array:
    """Sum (3,) of the moments of forces (n, 3) at lever arms (n, 3).

    >>> moment(np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 2.0, 0.0]])).tolist()
    [0.0, 0.0, 2.0]
    """
    m = arms.T @ forces
    return np.array([m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0]])


class RigidLoads(Kinematics):
    """The rigid-body part of the equations."""

    def gather_tied(self, state: State, nodal: Array, bodies: Array) -> None:
        """Add the forces of nodes that are tied to a body to the body's forces and moments."""
        for b, body in enumerate(self.bodies):
            if len(body.tied):
                f = nodal[body.tied]
                arm = self.X[body.tied] + state.u[body.tied] - self.center(b, state)
                bodies[b, :3] += f.sum(axis=0)
                bodies[b, 3:] += moment(arm, f)

    def add_springs(self, state: State, bodies: Array) -> None:
        index = {body.name: b for b, body in enumerate(self.bodies)}
        both = {body.name: (body, state.bodies[b]) for b, body in enumerate(self.bodies)}
        for spring in self.model.springs:
            on_a, on_b, _ = spring_forces(spring, both)
            bodies[index[spring.body_a]] -= on_a
            bodies[index[spring.body_b]] -= on_b

    def applied(self, time: float) -> Array:
        """Applied forces (N) and moments (N mm), (n_bodies, 6); loads on one degree of freedom are summed."""
        out = np.zeros((len(self.bodies), 6))
        index = {body.name: b for b, body in enumerate(self.bodies)}
        for drive in self.drives:
            if drive.is_load:
                factor = 1.0 if drive.curve is None else self.curve_at(drive.curve, time)
                out[index[drive.body], DOFS.index(drive.dof)] += drive.value * factor
        return out

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

    def tied_turning(self, state: State, nodal: Array, b: int) -> Array:
        """Derivative (3, 3) of the moment of the tied nodes' forces as their arms rotate with the body."""
        body = self.bodies[b]
        arm = self.X[body.tied] + state.u[body.tied] - self.center(b, state)
        return sum(
            (-skew(f) @ -skew(a) for f, a in zip(nodal[body.tied], arm, strict=True)), np.zeros((3, 3))
        )
