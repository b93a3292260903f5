"""Exact derivatives of the response at a converged state, by direct differentiation.

At equilibrium R(u(theta), theta) = 0, hence K du/dtheta = -dR/dtheta at fixed u, and a force F(u, theta)
has the derivative dF/dtheta = dF/dtheta|u + dF/du du/dtheta. This takes one linear solve per parameter and
level, reusing the existing factor; K is the exact tangent of the converged state.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial as partial_function

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.derivatives.parameters import Parameter, partial
from limbcli.fem.equilibrium.newton import Newton
from limbcli.fem.linear_solvers.krylov import gmres
from limbcli.fem.motion.state import Forces, State
from limbcli.fem.system import System
from limbcli.model import Array

_TOLERANCE = 1e-7  # relative residual at which GMRES stops
_ENOUGH = 1e-6  # relative residual that is accepted


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivative of the response with respect to a parameter.

    displacement (n_points, 3) : du/dtheta
    bodies (n_bodies, 6) : derivative of the forces and moments that hold the bodies
    motions (n_bodies, 6) : translation and rotation of bodies with free degrees of freedom
    contact : at the state
    """

    displacement: Array
    bodies: Array
    motions: Array
    contact: ContactState


def sensitivities(
    newton: Newton, state: State, forces: Forces, parameters: list[Parameter]
) -> list[Sensitivity]:
    """Derivatives of the response at a converged state with respect to each parameter.

    Raises SolveError if the response is path-dependent, or a linear system cannot be solved accurately.
    """
    system = newton.system
    if any(pair.contact.friction for pair in system.pairs):
        raise SolveError(
            "a response with friction depends on the loading path: it has no derivative at a state",
            where="derivatives",
            fix="difference whole solves, as a session does",
        )
    augmented = any(pair.contact.augmented for pair in system.pairs)
    continues_step = system.start.time > 0.0 and system.model.goes_on_from_steps
    if augmented or continues_step or any(h.any() for h in system.histories):
        raise SolveError(
            "the response depends on the loading path (augmented contact, steps of a viscoelastic law, "
            "or a step defined relative to the end of the previous one)",
            where="derivatives",
            fix="difference whole solves, as a session does",
        )
    loads = [partial(system, forces.contact, each) for each in parameters]
    newton.linearised.ready_for(len(loads), -np.log10(_TOLERANCE), state, forces)
    return [_one(newton, state, forces, nodal, bodies) for nodal, bodies in loads]


def reaction_changes(system: System, state: State, parameter: Parameter, sensitivity: Sensitivity) -> Array:
    """Derivatives (n_points, 3) of the reactions at nodes with prescribed displacements."""
    nodal, _ = partial(system, sensitivity.contact, parameter)
    v = sensitivity.displacement
    contact, _ = system.contact_times(sensitivity.contact, v, sensitivity.motions)
    return np.where(system.driven, nodal + system.tangent_times(state, v) + contact, 0.0)


def _one(newton: Newton, state: State, forces: Forces, nodal: Array, bodies: Array) -> Sensitivity:
    system = newton.system
    rhs = -np.concatenate([nodal[system.free], system.of_rigid(bodies)])
    step = _solve(newton, state, forces, rhs)
    motions = system.motions(step)
    v = system.follow(state, motions)
    v[system.free] = step[: system.n_tissue]
    change = _force_change(system, state, forces, v, motions)
    return Sensitivity(v, bodies + change, motions, forces.contact)


def _solve(newton: Newton, state: State, forces: Forces, rhs: Array) -> Array:
    reached, linearised = 1.0, newton.linearised
    for attempt in range(2):
        if linearised.tangent is None or linearised.inverse is None or attempt:
            linearised.refresh(state, forces)
        tangent, inverse = linearised.tangent, linearised.inverse
        assert tangent is not None
        assert inverse is not None
        inverse.follow(forces.contact)
        step, n, reached = gmres(
            partial_function(tangent.times, forces.contact),
            inverse,
            rhs,
            tolerance=_TOLERANCE,
            max_iterations=80,
        )
        newton.counts.krylov += n
        if reached <= _ENOUGH:
            return step
    raise SolveError(
        f"the linear system of a derivative was solved only to {reached:.1e}",
        where=f"time {state.time:g}",
        fix="the state is close to an instability: use smaller levels, or finite differences",
    )


def _force_change(system: System, state: State, forces: Forces, v: Array, motions: Array) -> Array:
    """Change (n_bodies, 6) of the bodies' forces and moments for nodal and body motions."""
    nodal, bodies = system.contact_times(forces.contact, v, motions)
    if any(len(body.tied) for body in system.bodies):
        nodal += system.tangent_times(state, v)
        system.gather_tied(state, nodal, bodies)
        for b, each in enumerate(system.bodies):
            if len(each.tied) and motions[b, 3:].any():
                bodies[b, 3:] += system.tied_turning(state, forces.nodal, b) @ motions[b, 3:]
    if system.model.springs:
        bodies += (system.spring_stiffness(state) @ motions.ravel()).reshape(-1, 6)
    return bodies
