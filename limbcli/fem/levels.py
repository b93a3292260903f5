"""The times of a step that are solved for."""

from __future__ import annotations

from limbcli.model import Step


def step_times(step: Step, *, every: bool = False) -> list[float]:
    """Times (s, from the start of the step) that are solved for: must-points and the end, else all steps.

    every : the equal steps of the model as well, for a response that depends on the way

    >>> step_times(Step(n_steps=4, step_size=0.25, must_points=(0.5,)))
    [0.5, 1.0]
    >>> step_times(Step(n_steps=4, step_size=0.1, must_points=(0.3,)), every=True)  # not 0.1 * 3
    [0.1, 0.2, 0.3, 0.4]
    """
    end = step.n_steps * step.step_size
    inner = [t for t in step.must_points if 0 < t < end * (1 - 1e-9)]
    if step.must_points and not every:
        return sorted({*inner, end})
    if every:
        grid = [step.step_size * (k + 1) for k in range(step.n_steps - 1)]
        between = [g for g in grid if all(abs(t - g) > 1e-9 * end for t in inner)]
        return sorted({*between, *inner, end})
    return [step.step_size * (k + 1) for k in range(step.n_steps - 1)] + [end]
