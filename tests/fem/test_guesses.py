"""First guesses on the polynomial through converged states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import punch

from limbcli.fem.equilibrium.first_guesses import beside, extrapolate
from limbcli.fem.system import System
from limbcli.model import Curve

DEPTHS = (0.2, 0.4, 0.6)


def at_depths(times: tuple[float, ...], depths: tuple[float, ...], rng: np.random.Generator):
    """System whose plate is at these depths at these times, and states quadratic in the depth."""
    model = punch("tet4")
    name = next(d.curve for d in model.drives if d.curve)
    value = next(d.value for d in model.drives if d.curve)
    points = ((0.0, 0.0), *((t, depth / abs(value)) for t, depth in zip(times, depths, strict=True)))
    system = System(replace(model, curves={**model.curves, name: Curve(points)}), threads=1)
    first, second = 0.01 * rng.standard_normal((2, *system.X.shape)) * system.free[None]
    states = []
    for time, depth in zip(times, depths, strict=True):
        state = system.prescribed(system.rest(), time)
        states.append(replace(state, u=np.where(system.free, first * depth + second * depth**2, state.u)))
    return system, states


@pytest.mark.parametrize("times", [(0.2, 0.4, 0.6, 0.8), (0.2, 0.4, 0.6, 0.65)])
def test_a_load_curve_may_go_at_any_pace(times: tuple[float, ...], rng: np.random.Generator) -> None:
    """What is quadratic in the plate's way is met exactly, with a kink in the load curve or without."""
    system, states = at_depths(times, (*DEPTHS, 0.8), rng)
    guess = extrapolate(system, states[:3], times[3])
    np.testing.assert_allclose(guess.u, states[3].u, atol=1e-14)


def test_a_plate_that_turns_back_is_followed_in_time(rng: np.random.Generator) -> None:
    system, states = at_depths((0.2, 0.4, 0.6, 0.8), (*DEPTHS, 0.4), rng)
    guess = extrapolate(system, states[:3], 0.8)
    line = 3 * states[2].u - 3 * states[1].u + states[0].u  # the parabola over even times
    np.testing.assert_allclose(guess.u[system.free], line[system.free], atol=1e-14)


def test_what_differs_from_an_earlier_solve_by_a_line_is_met_exactly(rng: np.random.Generator) -> None:
    """The earlier solve may be of any shape along the way; with one pair the difference is carried over."""
    times = (0.2, 0.4, 0.6)
    system, ours = at_depths(times, DEPTHS, rng)
    apart = 0.01 * rng.standard_normal(system.X.shape) * system.free
    theirs = [replace(each, u=each.u - depth * apart) for each, depth in zip(ours, DEPTHS, strict=True)]
    pairs = list(zip(ours[:2], theirs[:2], strict=True))
    np.testing.assert_allclose(beside(system, theirs[2], 0.6, pairs).u, ours[2].u, atol=1e-14)
    carried = beside(system, theirs[2], 0.6, pairs[1:])
    np.testing.assert_allclose(carried.u, ours[2].u - 0.2 * apart, atol=1e-14)


def test_a_body_that_turns_freely_is_guessed_with_the_skin_that_it_presses(rng: np.random.Generator) -> None:
    model = punch("tet4")
    system = System(replace(model, drives=tuple(d for d in model.drives if d.dof in "xyz")), threads=1)
    pace = np.array([0.1, -0.05, 0.02])
    states = [system.prescribed(system.rest(), time) for time in (0.2, 0.4, 0.5)]
    states = [replace(each, bodies=(replace(each.bodies[0], rotation=each.time * pace),)) for each in states]
    guess = extrapolate(system, states[:2], 0.5)
    np.testing.assert_allclose(guess.bodies[0].rotation, 0.5 * pace, atol=1e-14)
    still = [replace(each, bodies=(replace(each.bodies[0], rotation=0.0 * pace),)) for each in states]
    pair = [(states[1], still[1])]
    carried = beside(system, still[2], 0.5, pair)
    np.testing.assert_allclose(carried.bodies[0].rotation, 0.4 * pace, atol=1e-14)
