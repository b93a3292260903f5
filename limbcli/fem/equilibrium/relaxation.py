"""Equilibrium by pseudo-time relaxation with a drag, for loads at which Newton's method diverges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.fem.equilibrium.newton import Newton
from limbcli.fem.equilibrium.settings import LoadStep
from limbcli.fem.equilibrium.stagnation import Stagnation
from limbcli.fem.motion.state import Forces, State, norm
from limbcli.model import Array

_RELAXED = 60  # maximum number of pseudo-time steps
# Multiples of `System.drag`: initial, maximum, and value below which it is set to 0. They equal the shear
# resistance of tissue at wavelengths of 6 mm, 0.2 mm and 200 mm.
_DRAG, _MOST_DRAG, _LEAST_DRAG = 1.0, 1e3, 1e-3
_HELD = 0.1  # factor on the tolerance after a step with drag
_FIRMER = (4.0, 100.0)  # smallest and largest factor on the drag after a rejected step
_NONLINEAR = 2.0  # nonlinear residual, relative to the previous residual, above which a step is rejected


def relax(
    newton: Newton, guess: State, load_step: LoadStep, *, tolerance: float | None = None
) -> tuple[State, Forces]:
    """Solve for equilibrium from a guess by pseudo-transient continuation; raises NotConverged.

    Implicit steps in pseudo-time, with drag over step length added to the tangent's diagonal (Kelley and
    Keyes 1998, SIAM J. Numer. Anal. 35, 508-523); the more linear the response, the longer the steps.
    Along a soft mode the residual can be small although equilibrium is still far: after a step with drag a
    tighter tolerance applies. The method still works where the tangent is indefinite and Newton's method
    diverges.
    """
    system, linearised = newton.system, newton.linearised
    target = newton.settings.tolerance if tolerance is None else tolerance
    held = target if tolerance is not None else _HELD * target
    system.at(guess.time)
    state, forces = guess, newton.forces(guess)
    linearised.drag, stagnation = _DRAG, Stagnation(newton.settings.stalled)
    is_free = False
    try:
        for iteration in range(_RELAXED + 1):
            newton.report(load_step, iteration, forces)
            stagnation.note(forces)
            state = replace(state, hints=forces.contact.state.hints)
            if newton.is_reached(forces, target if is_free else held):
                return newton.accepted(forces, load_step, iteration)
            if iteration == _RELAXED or linearised.drag > _MOST_DRAG or stagnation.repeats:
                break
            newton.counts.iterations += 1
            step, contact = newton.direction(state, forces, True, target)
            found = _after(newton, replace(state, hints=contact.state.hints), step)
            nonlinear = np.inf if found is None else _nonlinear_part(newton, forces, found[1], step)
            if nonlinear > _NONLINEAR:
                # along a soft mode the step scales as 1 / drag, and the residual it leaves as its square
                firmer = float(np.clip(np.sqrt(_NONLINEAR * nonlinear), *_FIRMER))
                linearised.drag = firmer * max(linearised.drag, _LEAST_DRAG)
                continue
            assert found is not None
            state, forces = found
            is_free = linearised.drag == 0.0
            linearised.drag *= (
                0.2 if nonlinear < 0.3 else 0.5 if nonlinear < 0.7 else 1.0 if nonlinear < 1.0 else 2.0
            )
            if linearised.drag < _LEAST_DRAG:
                linearised.drag = 0.0
    finally:
        linearised.drag = 0.0
    if stagnation.acceptable:
        return newton.accepted(stagnation.acceptable, load_step, iteration)
    raise newton.failure(forces, load_step, iteration, "the tissue does not reach equilibrium")


def _after(newton: Newton, state: State, step: Array) -> tuple[State, Forces] | None:
    """State and forces after a step; None if a cell is inverted."""
    trial = newton.with_volumes(newton.system.moved(state, step), state)
    found = newton.forces(trial)
    sound = found.worst > 0 and np.isfinite(norm(found.iterated))
    return (trial, found) if sound else None


def _nonlinear_part(newton: Newton, before: Forces, after: Forces, step: Array) -> float:
    """Nonlinear part of the residual after a step, i.e. beyond the drag force, over the residual before."""
    system, linearised = newton.system, newton.linearised
    left = after.iterated.copy()
    held = system.collect(np.repeat(system.drag[:, None], 3, axis=1))
    left[: system.n_tissue] += linearised.drag * held * step[: system.n_tissue]
    size = max(min(norm(before.iterated), norm(before.residual)), newton.settings.tolerance * after.scale)
    return norm(left) / size
