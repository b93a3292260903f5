"""Rigid bodies: prescribed and free degrees of freedom, tied nodes, rotations and springs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array, IntArray, LimbModel
from limbcli.model.bodies import Drive, RigidBody, Spring

DOFS = ("x", "y", "z", "u", "v", "w")


def rotation_matrix(vector: Array) -> Array:
    """Matrix of the rotation by |vector| radians about the axis `vector` (Rodrigues' formula).

    >>> rotation_matrix(np.array([0.0, 0.0, np.pi / 2])).round(12)[0, 1]
    np.float64(-1.0)
    """
    angle = float(np.linalg.norm(vector))
    cross = np.array(
        [[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]], dtype=float
    )
    if angle < 1e-8:
        return np.eye(3) + cross + 0.5 * cross @ cross
    return np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross


def whole_rotation(vector: Array, before: Array) -> Array:
    """Rotation vector of a rotation `vector` after a rotation `before`, as FEBio holds it.

    FEBio multiplies unit quaternions, which return after two full turns; a rotation beyond one full turn is
    logged as one about the opposite axis.

    Source: FEBio 4.11, quatd::GetRotationVector; Shoemake 1985, SIGGRAPH Comput Graph 19:245.

    >>> whole_rotation(np.array([0.0, 0.0, 0.6]), np.array([0.0, 0.0, 3.0])).round(12)
    array([0. , 0. , 3.6])
    >>> whole_rotation(np.array([0.0, 0.0, 7.0]), np.zeros(3)).round(3)
    array([ 0.   ,  0.   , -5.566])
    """
    (a, u), (b, v) = _quaternion(vector), _quaternion(before)
    cosine, w = a * b - u @ v, a * v + b * u + np.cross(u, v)
    sine = float(np.linalg.norm(w))
    return w * (2 * np.arctan2(sine, cosine) / sine) if sine > 0 else np.zeros(3)


def _quaternion(vector: Array) -> tuple[float, Array]:
    half = 0.5 * float(np.linalg.norm(vector))
    return float(np.cos(half)), 0.5 * vector * np.sinc(half / np.pi)


@dataclass(frozen=True, eq=False)
class BodyState:
    """Position of a body: translation of its centre (mm) and rotation vector (rad, see `whole_rotation`)."""

    shift: Array
    rotation: Array

    @cached_property
    def turn(self) -> Array:
        """The rotation's matrix (3, 3)."""
        return rotation_matrix(self.rotation)

    def moved(self, step: Array) -> BodyState:
        """The position after a further translation and rotation vector, `step` (6)."""
        return BodyState(self.shift + step[:3], whole_rotation(step[3:], self.rotation))

    def place(self, points: Array, center: Array) -> Array:
        """Current positions of points of the body, given their reference positions."""
        return (points - center) @ self.turn.T + center + self.shift


AT_REST = BodyState(np.zeros(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body of the model.

    drives : by degree of freedom ("x" .. "w"); one without a drive is free, and so is one with loads, of
        which only the last is stored here
    tied : tissue nodes that move with the body: those of its node sets and those shared with its blocks
    """

    name: str
    center: Array
    drives: dict[str, Drive]
    tied: IntArray
    points: IntArray
    free: tuple[int, ...] = ()

    def given(self, dof: str) -> bool:
        drive = self.drives.get(dof)
        return drive is not None and not drive.is_load


def make_bodies(model: LimbModel, drives: tuple[Drive, ...]) -> list[Body]:
    """The model's rigid bodies with their active drives."""
    names = {body.name for body in model.bodies}
    for each in drives:
        if each.body not in names:
            raise SolveError(
                f"a drive for the unknown body {each.body!r}", where="rigid bodies", fix=f"use one of {names}"
            )
    return [_body(model, body, drives) for body in model.bodies]


def _body(model: LimbModel, body: RigidBody, drives: tuple[Drive, ...]) -> Body:
    mine: dict[str, Drive] = {}
    for each in drives:
        if each.body != body.name:
            continue
        before = mine.get(each.dof)
        if before is not None and before != each and not (before.is_load and each.is_load):
            raise SolveError(
                f"body {body.name!r} has two drives for {each.dof}", where="rigid bodies", fix="keep one"
            )
        mine[each.dof] = each
    points = model.mesh.nodes_of(body.blocks)
    shared = np.intersect1d(points, model.mesh.nodes_of(domain.block for domain in model.domains))
    tied = np.unique(np.concatenate([*(model.mesh.node_sets[name] for name in body.node_sets), shared]))
    made = Body(body.name, np.array(body.center_of_mass, dtype=float), mine, tied, points)
    is_sprung = any(body.name in (spring.body_a, spring.body_b) for spring in model.springs)
    if not (len(tied) or len(points) or is_sprung):
        return made
    return replace(made, free=tuple(k for k, dof in enumerate(DOFS) if not made.given(dof)))


def spring_forces(spring: Spring, bodies: dict[str, tuple[Body, BodyState]]) -> tuple[Array, Array, Array]:
    """Force and moment (6) on body a, on body b (at its own centre), and the stiffness (12, 12) of both.

    The stiffness is the derivative of minus the forces with respect to the motions
    (translation, rotation) of a and b.
    """
    (a, sa), (b, sb) = bodies[spring.body_a], bodies[spring.body_b]
    end_a, end_b = np.array(spring.insertion_a, dtype=float), np.array(spring.insertion_b, dtype=float)
    ra, rb = sa.turn @ (end_a - a.center), sb.turn @ (end_b - b.center)
    line = (b.center + sb.shift + rb) - (a.center + sa.shift + ra)
    length = float(np.linalg.norm(line))
    if length == 0.0:
        raise SolveError(
            f"spring {spring.name!r} has no length", where="rigid springs", fix="move an insertion point"
        )
    unit = line / length
    tension = spring.stiffness * (length - spring.slack_length)
    along = np.outer(unit, unit)
    k = spring.stiffness * along + tension / length * (np.eye(3) - along)
    pull = tension * unit
    on_a = np.concatenate([pull, np.cross(ra, pull)])
    on_b = -np.concatenate([pull, np.cross(rb, pull)])
    B = np.concatenate([-np.eye(3), skew(ra), np.eye(3), -skew(rb)], axis=1)  # d(line)
    K = B.T @ k @ B
    K[3:6, 3:6] -= skew(pull) @ skew(ra)  # the lever arms rotate with the bodies
    K[9:12, 9:12] += skew(pull) @ skew(rb)
    return on_a, on_b, K


def skew(v: Array) -> Array:
    """Matrix of the cross product v x."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]], dtype=float)
