"""The times that are solved for: an automatic stepper's, as FEBio takes them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_models import block

from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.fem.equilibrium.solve_times import listed_times, step_times
from limbcli.model import Curve, Step


@pytest.mark.parametrize("name", ["deep-39mm"])
def test_steps_grow_as_febios(shared: Path, name: str) -> None:
    """Where FEBio cut none of its steps."""
    text = (shared / "febio-hidden" / "reference" / name / "febio-summary.txt").read_text()
    theirs = [float(t) for t in re.findall(r"beginning time step \d+ : (\S+)", text)]
    ours = step_times(Step(200, 0.005, dt_min=0.0015, dt_max=0.076923077, opt_iterations=25, max_retries=4))
    np.testing.assert_allclose(ours[-len(theirs) :], theirs, rtol=3e-6)  # printed to six digits
    assert len(ours) == 18


def test_a_must_point_shortens_one_step_only() -> None:
    times = step_times(Step(10, 0.1, dt_max=0.3, must_points=(0.35, 0.9)), every=True)
    # 0.1, then 0.14, then 0.172 cut at 0.35; 0.1976, then 0.21808, then what is left to 0.9 and to the end
    np.testing.assert_allclose(times, [0.1, 0.24, 0.35, 0.5476, 0.76568, 0.9, 1.0], rtol=1e-9)


def test_the_largest_step_may_follow_a_curve() -> None:
    model = block("tet4", (1, 1, 1))
    curve = Curve(((0.0, 0.1), (0.5, 0.1), (0.51, 0.5), (2.0, 0.5)))
    step = Step(20, 0.1, dt_max=0.5, dt_max_curve="steps")
    analysis = Analysis(replace(model, curves={**model.curves, "steps": curve}, steps=(step,)), Settings())
    (times,) = analysis.times()
    steps = np.diff([0.0, *times])
    early = np.array(times) <= 0.5 + 1e-9
    np.testing.assert_allclose(steps[early], 0.1)
    assert steps[~early].max() > 0.2


def test_without_a_stepper_steps_are_equal() -> None:
    np.testing.assert_allclose(step_times(Step(4, 0.25, adaptive=False, dt_max=0.5)), [0.25, 0.5, 0.75, 1.0])


def test_steps_of_one_size_are_alike_from_must_point_to_must_point() -> None:
    """With friction a long step and a short one in turn take up to twice the work of two alike."""
    musts = (0.118, 0.236, 0.354, 0.472)
    step = Step(10, 0.06, dt_max=0.1, must_points=musts, adaptive=False)
    times = np.array([0.0, *step_times(step, every=True)])
    np.testing.assert_allclose(np.diff(times), [0.059] * 8 + [0.064] * 2)
    assert set(musts) <= set(times)


@pytest.mark.parametrize("adaptive", [True, False])
@pytest.mark.parametrize("begin", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("n_steps", [7, 10, 20])
def test_a_must_point_at_the_end_is_met_to_the_last_digit(n_steps: int, begin: float, adaptive: bool) -> None:
    """Although ten steps of 0.1 s add up to less than 1 s."""
    step = Step(n_steps, 0.1, must_points=(round(n_steps * 0.1, 12),), adaptive=adaptive)
    times = step_times(step, begin=begin, every=True)
    assert len(times) == n_steps
    assert {times[-1]} == set(step_times(step, begin=begin)) == listed_times(step, begin)


def test_no_step_is_longer_than_the_largest() -> None:
    """Nor is the first: 5 steps of 0.2 s become 10 of 0.1 s; after a must-point they go on from there."""
    step = Step(5, 0.2, dt_min=0.0, dt_max=0.1)
    np.testing.assert_allclose(step_times(step), np.arange(1, 11) / 10)
    times = step_times(replace(step, n_steps=2, must_points=(0.25,)), every=True)
    np.testing.assert_allclose(times, [0.1, 0.2, 0.25, 0.35, 0.4])
    curved = step_times(step, largest=lambda time: 0.4 if time else 0.1)
    np.testing.assert_allclose(curved[:2], [0.1, 0.26])
