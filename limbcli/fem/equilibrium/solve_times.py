"""The times within an analysis step that are solved for."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

from limbcli.model import Step

# Growth of FEBio's automatic time step after an easy step: by this fraction of the difference to the largest
# step, and at most by this factor (FEBio 4.11, from its logs).
_GROWTH, _MOST = 0.2, 5.0
_DIGITS = 12  # of a time in a model file
_NEAR = 1e-9  # difference at which two times count as equal, as a fraction of the step's duration


def step_times(
    step: Step,
    *,
    begin: float = 0.0,
    every: bool = False,
    largest: Callable[[float], float] | None = None,
) -> list[float]:
    """Times (s, of the whole analysis) to solve for: must-points and the end, else all time steps.

    Automatic time steps grow towards the largest step size as in FEBio when every step converges easily;
    where this solver does not, it subdivides the step. With `dtforce` every step has the largest size. A
    must-point is met by a shortened step, after which steps continue at the previous size. Without automatic
    stepping, the steps between two must-points are of equal length. Between must-points steps are added up
    one by one as in FEBio, since the round-off of the sum decides on which side of a jump of a load curve a
    time lies; without must-points the end is such a sum, too.

    begin : time (s) at which the step begins
    every : include the time steps between must-points, for a path-dependent response
    largest : largest step size as a function of time (s, of the whole analysis), if `dt_max` varies

    Source: FEBio 4.11, FEAnalysis::Solve and FETimeStepController::AutoTimeStep.

    >>> step_times(Step(n_steps=4, step_size=0.25, must_points=(0.5,)))
    [0.5, 1.0]
    >>> step_times(Step(n_steps=4, step_size=0.25, must_points=(0.5, 0.5)), begin=1.0)  # each time once
    [1.5, 2.0]
    >>> step_times(Step(n_steps=4, step_size=0.1, must_points=(0.3,)), every=True)  # not 0.1 * 3
    [0.1, 0.2, 0.3, 0.4]
    >>> [round(t, 4) for t in step_times(Step(n_steps=10, step_size=0.1, dt_max=0.6))]
    [0.1, 0.3, 0.58, 0.924, 1.0]
    >>> step_times(Step(n_steps=2, step_size=0.4, must_points=(0.7,), adaptive=False), every=True)
    [0.35, 0.7, 0.8]
    >>> step_times(Step(n_steps=2, step_size=0.5, dt_max=0.25))
    [0.25, 0.5, 0.75, 1.0]
    >>> step_times(Step(n_steps=7, step_size=0.1, adaptive=False))[-1] < 7 * 0.1
    True
    >>> step_times(Step(n_steps=6, step_size=1 / 6, must_points=(1.0,)), every=True)[-1]  # not the sum
    1.0
    """
    length = step.n_steps * step.step_size
    end, near = begin + length, _NEAR * length
    inner = sorted({_from_start(begin, t) for t in step.must_points if 0 < t < length - near})
    if step.must_points and not every:
        return [*inner, end]
    dt, forced = step.step_size, bool(step.control.get("dtforce"))
    if step.adaptive:
        most = largest(begin) if largest else step.dt_max
        dt = most if forced and most else min(max(dt, step.dt_min), most or math.inf)
    elif step.must_points:
        return [time for ends in itertools.pairwise([begin, *inner, end]) for time in _evenly(*ends, dt)]
    goals, times = [*inner, end], [begin]
    while end - times[-1] > near:
        if len(times) > 1 and step.adaptive:
            most = largest(times[-1]) if largest else step.dt_max or dt
            dt = (
                most
                if forced
                else min(dt + _GROWTH * max(most - dt, 0.0), _MOST * dt, max(most, step.dt_min))
            )
        goal = next(each for each in goals if each > times[-1])
        meets = goal <= times[-1] + dt + (near if step.must_points else 0.0)
        times.append(goal if meets and step.adaptive else times[-1] + dt)
    return times[1:]


def counts_every_step(step: Step) -> bool:
    """Whether all of its time steps have to be solved for: their size is given, or records count them."""
    level, stride = (step.control.get(name) for name in ("output_level", "output_stride"))
    chosen = level not in (None, "OUTPUT_MAJOR_ITRS", "1") or stride not in (None, 1)
    return chosen or bool(step.control.get("dtforce"))


def listed_times(step: Step, begin: float) -> set[float]:
    """Those of the step's times that are must-points; its end is one only if it is listed.

    >>> listed_times(Step(n_steps=4, step_size=0.25, must_points=(0.5,)), 0.0)
    {0.5}
    """
    near = _NEAR * step.n_steps * step.step_size
    points = [_from_start(begin, t) for t in step.must_points]
    return {t for t in step_times(step, begin=begin) if any(abs(t - each) <= near for each in points)}


def _from_start(begin: float, time: float) -> float:
    """The time of the whole analysis, as a file writes it.

    >>> 0.1 + 0.2, _from_start(0.1, 0.2)
    (0.30000000000000004, 0.3)
    """
    return round(begin + time, _DIGITS) if begin else time


def _evenly(begin: float, end: float, size: float) -> list[float]:
    """Equidistant times from `begin` (excluded) to `end`, about `size` apart."""
    n = max(round((end - begin) / size), 1)
    return [*(begin + (end - begin) * k / n for k in range(1, n)), end]
