"""Equilibrium by pseudo-time: tissue held back by a drag comes to rest where Newton's method runs astray."""

from __future__ import annotations

import numpy as np

from limbcli.fem.equilibrium.newton import Newton
from limbcli.fem.equilibrium.settings import LoadStep
from limbcli.fem.equilibrium.stagnation import Stagnation
from limbcli.fem.motion.state import Forces, State, norm
from limbcli.model import Array

_RELAXED = 60  # steps of pseudo-time at most
# Drag at first, the most, and below which it is nothing: of waves of 6 mm, 0.2 mm and 200 mm.
_DRAG, _MOST_DRAG, _LEAST_DRAG = 1.0, 1e3, 1e-3
_HELD = 0.1  # of the tolerance: what equilibrium may leave after a step that drag has held back
_FIRMER = (4.0, 100.0)  # times the drag after a step that went too far: at least, at most
_BENT = 2.0  # of the residual before: what a step may leave beyond what the drag on it does


def relax(
    newton: Newton, guess: State, load_step: LoadStep, *, tolerance: float | None = None
) -> tuple[State, Forces]:
    """The equilibrium that tissue held back by a drag comes to from a guess; raises NotConverged.

    Implicit steps in a pseudo-time, with the drag over the step's length on the tangent's diagonal
    (Kelley and Keyes 1998, SIAM J. Numer. Anal. 35, 508-523); the straighter the tissue responds, the
    longer. Along a soft mode a drag leaves little residual and yet a long way to go: after a step with it,
    equilibrium is asked for more strictly. Such steps go on where the tangent has lost its definiteness
    and Newton's method runs astray.
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
            newton.note(stagnation, state, forces)
            if newton.is_reached(forces, target if is_free else held):
                return newton.accepted(state, forces, load_step, iteration)
            if iteration == _RELAXED or linearised.drag > _MOST_DRAG or stagnation.goes_round:
                break
            newton.counts.iterations += 1
            step = newton.direction(state, forces, True, target)
            found = _after(newton, state, step)
            bent = np.inf if found is None else _bent(newton, forces, found[1], step)
            if bent > _BENT:
                # along a soft mode the step is as 1 / drag, what it leaves as its square
                firmer = float(np.clip(np.sqrt(_BENT * bent), *_FIRMER))
                linearised.drag = firmer * max(linearised.drag, _LEAST_DRAG)
                newton.forces(state)
                continue
            assert found is not None
            state, forces = found
            is_free = linearised.drag == 0.0
            linearised.drag *= 0.2 if bent < 0.3 else 0.5 if bent < 0.7 else 1.0 if bent < 1.0 else 2.0
            if linearised.drag < _LEAST_DRAG:
                linearised.drag = 0.0
    finally:
        linearised.drag = 0.0
    if stagnation.will_do:
        return newton.accepted(*newton.least_of(stagnation), load_step, iteration)
    raise newton.failure(state, forces, load_step, iteration, "the tissue does not reach equilibrium")


def _after(newton: Newton, state: State, step: Array) -> tuple[State, Forces] | None:
    """State and forces after a step; None where a cell is turned inside out."""
    trial = newton.with_volumes(newton.system.moved(state, step), state)
    found = newton.forces(trial)
    sound = found.worst > 0 and np.isfinite(norm(found.mixed))
    return (trial, found) if sound else None


def _bent(newton: Newton, before: Forces, after: Forces, step: Array) -> float:
    """What a step left beyond what the linearised tissue would leave (the drag), over the residual."""
    system, linearised = newton.system, newton.linearised
    left = after.mixed.copy()
    held = system.collect(np.repeat(system.drag[:, None], 3, axis=1))
    left[: system.n_tissue] += linearised.drag * held * step[: system.n_tissue]
    size = max(min(norm(before.mixed), norm(before.residual)), newton.settings.tolerance * after.scale)
    return norm(left) / size
