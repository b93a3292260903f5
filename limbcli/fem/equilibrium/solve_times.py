"""The times within an analysis step that are solved for."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

from limbcli.model import Step

# Growth of FEBio's automatic time step after an easy step: by this fraction of the difference to the largest
# step, and at most by this factor (FEBio 4.11, from its logs).
_GROWTH, _MOST = 0.2, 5.0
_NEAR = 1e-9  # difference at which two times count as equal, as a fraction of the step's duration


def step_times(
    step: Step, *, every: bool = False, largest: Callable[[float], float] | None = None
) -> list[float]:
    """Times (s, from the start of the step) to solve for: must-points and the end, else all time steps.

    Automatic time steps grow towards the largest step size as in FEBio when every step converges easily;
    where this solver does not, it subdivides the step. A must-point is met by a shortened step, after which
    steps continue at the previous size. Without automatic stepping, the steps between two must-points are
    of equal length.

    every : include the time steps between must-points, for a path-dependent response
    largest : largest step size as a function of time (s, from the start of the step), if `dt_max` varies

    >>> step_times(Step(n_steps=4, step_size=0.25, must_points=(0.5,)))
    [0.5, 1.0]
    >>> step_times(Step(n_steps=4, step_size=0.25, must_points=(0.5, 0.5)))  # each time once
    [0.5, 1.0]
    >>> step_times(Step(n_steps=4, step_size=0.1, must_points=(0.3,)), every=True)  # not 0.1 * 3
    [0.1, 0.2, 0.3, 0.4]
    >>> [round(t, 4) for t in step_times(Step(n_steps=10, step_size=0.1, dt_max=0.6))]
    [0.1, 0.3, 0.58, 0.924, 1.0]
    >>> step_times(Step(n_steps=2, step_size=0.4, must_points=(0.7,), adaptive=False), every=True)
    [0.35, 0.7, 0.8]
    >>> step_times(Step(n_steps=2, step_size=0.5, dt_max=0.25))
    [0.25, 0.5, 0.75, 1.0]
    """
    end = step.n_steps * step.step_size
    inner = sorted({t for t in step.must_points if 0 < t < end * (1 - _NEAR)})
    if step.must_points and not every:
        return [*inner, end]
    dt = step.step_size
    if step.adaptive:
        most = largest(0.0) if largest else step.dt_max
        dt = min(max(dt, step.dt_min), most or math.inf)
    if not inner and (not step.adaptive or (largest is None and (step.dt_max or dt) <= dt)):
        return [*(dt * (k + 1) for k in range(math.ceil(end / dt - _NEAR) - 1)), end]
    goals, times = [*inner, end], [0.0]
    if not step.adaptive:
        return [time for ends in itertools.pairwise([0.0, *goals]) for time in _evenly(*ends, dt)]
    while times[-1] < end:
        if len(times) > 1:
            most = largest(times[-1]) if largest else step.dt_max or dt
            dt = min(dt + _GROWTH * max(most - dt, 0.0), _MOST * dt, max(most, step.dt_min))
        goal = next(each for each in goals if each > times[-1])
        times.append(goal if goal <= times[-1] + dt + _NEAR * end else times[-1] + dt)
    return times[1:]


def _evenly(begin: float, end: float, size: float) -> list[float]:
    """Equidistant times from `begin` (excluded) to `end`, about `size` apart."""
    n = max(round((end - begin) / size), 1)
    return [*(begin + (end - begin) * k / n for k in range(1, n)), end]
