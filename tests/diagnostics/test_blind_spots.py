"""What stays unseen and what it costs, in two data of which a fitted parameter takes one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnostics.conclusions.blind_spots import blind_spot
from limbcli.diagnostics.model.forward_model import Direction
from limbcli.diagnostics.model.linear import LinearFit

CRITICAL = 3.84


def spot(typical: float, scale: float = 1.0):
    """A parameter (a logarithm) that moves the first datum by 2; an effect that moves them by 0.6 and 0.8."""
    state = LinearFit.of(np.zeros(2), np.array([[2.0], [0.0]]))
    direction = Direction(np.array([[0.6], [0.8]]), (0,), "at 3")
    return blind_spot(
        state, "x", direction, np.array([typical]), critical=CRITICAL, base_names=("c",), scale=scale
    )


def test_the_fitted_parameters_take_over_their_part_of_the_effect():
    found = spot(0.5)
    assert found.visible_fraction == pytest.approx(0.8)
    assert found.bias_sd["c"] == pytest.approx(0.6 * 0.5)  # of 1/2, which is one deviation
    assert found.bias_percent["c"] == pytest.approx(100 * (np.exp(0.15) - 1))


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_the_size_that_can_be_detected_is_detected_four_times_of_five(scale, rng):
    found = spot(0.5, scale)
    size = 0.5 * found.detectable_times_typical
    seen = 0.8 * size + np.sqrt(scale) * rng.standard_normal(40_000)
    assert np.mean(seen**2 > CRITICAL) == pytest.approx(0.8, abs=0.01)
    assert found.bias_sd["c"] == pytest.approx(0.3 / np.sqrt(scale))


def test_what_matters_is_unseen_and_moves_a_parameter_by_more_than_its_deviation():
    assert [spot(size).matters for size in (1.0, 3.0, 4.0)] == [False, True, False]  # too small, both, seen
    assert replace(spot(3.0), bias_sd={"c": -1.8}).matters
