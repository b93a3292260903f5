"""Exact derivatives of the response at a converged state, by direct differentiation.

At equilibrium R(u(theta), theta) = 0, hence K du/dtheta = -dR/dtheta at held u, and a
force F(u, theta) changes by dF/dtheta = dF/dtheta|u + dF/du du/dtheta. One linear solve per
parameter and level, with the factor that is already there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem import contact_kernels, kernels
from limbcli.fem.contact import penalty_derivative
from limbcli.fem.newton import Newton
from limbcli.fem.system import State, System
from limbcli.fem.tangent import gmres
from limbcli.materials import Program
from limbcli.model import Array

_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class LawParameter:
    """A number of a material: "c1" of "tissue" ("0.mu" in a mixture's first part).

    weights (n_cells,) : where given, cell e of the block moves by weights[e] theta (a map coefficient)
    """

    material: str
    name: str
    block: str | None = None
    weights: Array | None = None


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """du/dtheta (n_points, 3) and the derivative of the bodies' forces (n_bodies, 6)."""

    displacement: Array
    bodies: Array
    unknowns: Array


def partial(system: System, state: State, parameter: LawParameter) -> tuple[Array, Array]:
    """dR/dtheta at held displacements: nodal (n_points, 3) and bodies (n_bodies, 6)."""
    nodal, bodies = np.zeros_like(system.X), np.zeros((len(system.bodies), 6))
    found = False
    for number, group in enumerate(system.groups):
        if group.material.name != parameter.material:
            continue
        if parameter.block is not None and group.block != parameter.block:
            continue
        found = True
        programs = group.material.derivative(
            parameter.name, len(group.cells), system.curve, weights=parameter.weights
        )
        _add_internal(system, state, number, programs, nodal)
        contact = np.zeros_like(nodal)
        for pair in system.pairs:
            for patch in pair.patches:
                deps = penalty_derivative(pair.contact, patch, system.groups, number, system.curve, programs)
                if deps.any():
                    body = np.zeros(6)
                    contact_kernels.scaled_force(
                        patch.facets, patch.N, patch.weights, patch.state, deps,
                        system.center(pair.body, state), contact, body,
                    )  # fmt: skip
                    bodies[pair.body] -= body
        nodal += contact
    if not found:
        raise SolveError(
            f"no region is made of {parameter.material!r}",
            where=f"derivative with respect to {parameter.material}.{parameter.name}",
            fix=f"use one of {sorted({g.material.name for g in system.groups})}",
        )
    for b, body in enumerate(system.bodies):
        system._add_tied(b, body, state, nodal, bodies)
    return nodal, bodies


def _add_internal(system: System, state: State, number: int, programs: list[Program], out: Array) -> None:
    operands = system.operands[number]
    for program in programs:
        args = operands.with_program(program).arguments()
        parts = [np.zeros_like(out) for _ in range(system.threads.n)]
        system.threads.run(
            lambda w, a, b, args=args, parts=parts: kernels.internal_force(a, b, state.u, *args, parts[w]),
            len(operands.cells),
        )
        for each in parts:
            out += each


def solve(newton: Newton, state: State, loads: list[tuple[Array, Array]]) -> list[Sensitivity]:
    """Sensitivities at a converged state for partial derivatives `loads`; the tangent is made exact first."""
    system = newton.system
    forces = system.forces(state)
    newton.exact_tangent(state, forces)
    assert newton.tangent is not None and newton.inverse is not None
    tangent = newton.tangent
    out = []
    for nodal, bodies in loads:
        rhs = -np.concatenate([nodal[system.free], [bodies[k] for k in system.rigid]])
        step, n, reached = gmres(
            lambda v: tangent.times(state, v), newton.inverse, rhs, tolerance=_TOLERANCE, max_iterations=80
        )
        newton.counts.krylov += n
        if reached > 1e-6:
            newton.refresh(state, forces)
            step, n, reached = gmres(
                lambda v: tangent.times(state, v),
                newton.inverse,
                rhs,
                tolerance=_TOLERANCE,
                max_iterations=80,
            )
        motions = system.motions(step)
        v = system.follow(state, motions)
        v[system.free] = step[: system.n_tissue]
        out.append(Sensitivity(v, bodies + body_forces(system, state, v, motions), step))
    return out


def body_forces(system: System, state: State, v: Array, motions: Array) -> Array:
    """Change (n_bodies, 6) of the bodies' forces along nodal and body motions."""
    nodal, bodies = system.contact_times(state, v, motions)
    if any(len(body.tied) for body in system.bodies):
        elastic = system.tangent_times(state, v) + nodal
        for b, body in enumerate(system.bodies):
            system._add_tied(b, body, state, elastic, bodies)
            if len(body.tied) and motions[b, 3:].any():
                total = system.forces(state).nodal
                bodies[b, 3:] += system.tied_turning(state, total, b) @ motions[b, 3:]
    if system.model.springs:
        bodies += (system.spring_stiffness(state) @ motions.ravel()).reshape(-1, 6)
    return bodies
