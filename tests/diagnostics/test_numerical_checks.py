"""What mesh and geometry leave to doubt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.effects.curves import Curves, continued, log_force_at
from limbcli.measurement.indentation import Levels
from limbcli.stages.diagnosis.curves.site_simulations import FIRST_M
from limbcli.stages.diagnosis.forward_model.changes import filled
from limbcli.stages.diagnosis.mesh_error.numerical_checks import (
    Intervention,
    NumericalChecks,
    measured_slope,
    too_doubtful,
)


def curve(power: float) -> Curves:
    depth = np.array([0.0, 1.0, 2.0, 4.0, 8.0])
    return Curves(depth, 0.7 * depth**power, np.zeros((5, 0)), np.zeros(0))


def test_force_between_and_beyond_solved_depths_is_that_of_a_power_of_depth():
    at = np.array([0.2, 1.5, 3.0, 8.0, 10.0])
    assert np.exp(log_force_at(curve(1.4), at)) == pytest.approx(0.7 * at**1.4, rel=1e-9)


def test_measured_slope_is_that_of_the_loading_and_nothing_while_depth_falls():
    depth = np.array([0.0, 2.0, 4.0, 6.0, 4.0, 2.0])
    n = len(depth)
    nan, one = np.full(n, np.nan), np.ones(n)
    found = Levels(
        2.0 * depth, depth, nan, nan, nan, ("load",) * 4 + ("unload",) * 2, one, nan, nan, Path("x")
    )
    assert measured_slope(found)[:3] == pytest.approx(2.0, rel=1e-3)
    assert measured_slope(found)[4:] == pytest.approx(0.0)


def test_gaps_are_closed_by_the_nearest_depth_but_too_many_are_not():
    table = np.array([[0.0, 1.0, 2.0], [0.1, np.nan, 2.0], [0.2, 3.0, np.nan]])
    assert filled(table) == pytest.approx(np.array([[0.0, 1.0, 2.0], [0.1, 2.0, 2.0], [0.2, 3.0, 2.0]]))
    empty = np.array([[0.0, np.nan, np.nan], [0.1, np.nan, np.nan], [0.2, 1.0, 1.0]])
    assert np.isnan(filled(empty)).any()


def test_curves_go_on_beyond_what_was_reached():
    depth = np.array([0.0, 1.0, 2.0, 4.0])
    speeds = np.column_stack([0.1 * depth, 0.2 - 0.05 * depth])
    known = Curves(depth, 0.7 * depth**1.4, speeds, np.zeros(2))
    found = continued(known, [5.0, 8.0])
    assert found.depth == pytest.approx([0.0, 1.0, 2.0, 4.0, 5.0, 8.0])
    assert found.force == pytest.approx(0.7 * found.depth**1.4, rel=1e-9)
    assert found.log_speed[-1] == pytest.approx([0.8, -0.2])


def test_curves_go_on_beside_others_that_reach_further():
    depth = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 8.0])
    speeds = np.column_stack([0.1 * depth**2, 0.2 - 0.05 * depth])
    like = Curves(depth, 0.7 * depth**1.4, speeds, np.zeros(2))
    known = Curves(
        depth[:4],
        2.0 * (like.force * np.exp(0.03 * depth))[:4],
        (speeds + 0.02 * depth[:, None])[:4],
        np.zeros(2),
    )
    found = continued(known, depth[4:], like=like)
    assert found.force == pytest.approx(2.0 * like.force * np.exp(0.03 * depth), rel=1e-9)
    assert found.log_speed == pytest.approx(speeds + 0.02 * depth[:, None])


def test_numerical_checks_are_made_at_the_m_that_the_measured_force_follows():
    """Whatever c and the readings' scatter."""

    class Book:
        def curves(self, m: float) -> Curves:
            return curve(1.0 + 0.1 * m)

    for m in FIRST_M:
        depth = np.array([0.0, 1.0, 2.0, 4.0, 6.0, 7.0])
        n = len(depth)
        nan, one = np.full(n, np.nan), np.ones(n)
        force = 3.0 * depth ** (1.02 + 0.1 * m) * (1 + 0.02 * np.cos(9 * depth))
        levels = Levels(force, depth, nan, nan, nan, ("load",) * n, one, nan, nan, Path("x"))
        numerics = NumericalChecks(
            None, None, levels, Book(), out=Path(), size=5.0, notes=None, progress=None
        )
        assert numerics.likely_m == m


def test_doubt_that_is_a_large_part_of_the_force_is_warned_of():
    def tried(name: str, change: float) -> Intervention:
        return Intervention(name, np.array([0.0, change]), np.zeros((2, 0)), 1.0)

    assert too_doubtful([tried("contact", -0.12), tried("locking", 0.9)]) is None
    estimates = too_doubtful([tried("contact", -0.3), tried("f-kappa", 0.22), tried("crop", 0.01)])
    assert estimates is not None
    assert "contact 35 %, f-kappa 25 %" in estimates
