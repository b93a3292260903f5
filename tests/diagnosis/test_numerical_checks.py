"""What mesh and geometry leave to doubt."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.case import StatedNoise
from limbcli.diagnosis.curves.curve_plan import FIRST_M
from limbcli.diagnosis.mesh_error.numerical_checks import Intervention, NumericalChecks, large_uncertainty
from limbcli.effects.curves import Curves, continued, filled, log_force_at
from limbcli.measurement.indentation import Levels


def curve(power: float) -> Curves:
    depth = np.array([0.0, 1.0, 2.0, 4.0, 8.0])
    return Curves(depth, 0.7 * depth**power, np.zeros((5, 0)), np.zeros(0))


def test_force_between_and_beyond_solved_depths_is_that_of_a_power_of_depth():
    at = np.array([0.2, 1.5, 3.0, 8.0, 10.0])
    assert np.exp(log_force_at(curve(1.4), at)) == pytest.approx(0.7 * at**1.4, rel=1e-9)


def test_below_and_beyond_it_is_the_power_of_the_nearest_two_depths():
    depth = np.array([0.0, 1.0, 2.0, 4.0, 8.0])
    bent = Curves(depth, np.array([0.0, 0.5, 0.5 * 2**1.2, 2.0, 2.0 * 2**2.5]), np.zeros((5, 0)), np.zeros(0))
    found = np.exp(log_force_at(bent, np.array([0.1, 0.4, 16.0])))
    assert found == pytest.approx([0.5 * 0.1**1.2, 0.5 * 0.4**1.2, 2.0 * 4**2.5])


def test_levels_on_the_way_back_err_by_their_depth_as_those_on_the_way_do():
    """So that 3 % of the force are as many deviations whether the way back was read or not."""
    up = np.linspace(0.0, 20.0, 11)
    stiffer = replace(curve(1.4), force=1.03 * curve(1.4).force)
    sizes = []
    for force in (up, np.r_[up, up[-2::-1]]):
        n = len(force)
        nan, phase = np.full(n, np.nan), ("load",) * 11 + ("unload",) * (n - 11)
        depth = 3.0 * np.log1p(force / 2.0)
        found = Levels(
            force=force,
            depth=depth,
            swe_mean_m_per_s=nan,
            swe_sd_m_per_s=nan,
            swe_pixels=nan,
            phase=phase,
            hold=np.ones(n),
            probe_travel=nan,
            skin_bone=nan,
            path=Path("x"),
        )
        site = SimpleNamespace(noise=StatedNoise(force=0.1, depth=0.3))
        checks = NumericalChecks(None, site, found, None, out=Path(), size=5.0, notes=None, progress=None)
        sizes.append(checks._judged("crop", curve(1.4), stiffer, "").deviations)
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-3)
    assert sizes[0] == pytest.approx(np.log(1.03) * 20.0 / np.hypot(0.1, 0.3 * 22.0 / 3.0), rel=0.02)


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


def test_curves_solved_at_some_depths_follow_others_between_them():
    depth = np.array([0.0, 0.5, 1.0, 2.0, 4.0])
    speeds = np.column_stack([0.1 * depth**2, 0.2 - 0.05 * depth])
    like = Curves(depth, 0.7 * depth**1.4, speeds, np.zeros(2))
    changed = replace(
        like, force=2.0 * like.force * np.exp(0.03 * depth), log_speed=speeds + 0.02 * depth[:, None]
    )
    rows = [0, 2, 4]
    gap = changed.log_speed[rows].copy()
    gap[1, 1] = np.nan
    known = replace(changed, depth=depth[rows], force=changed.force[rows], log_speed=gap)
    found = filled(known, like, rows)
    np.testing.assert_array_equal(found.depth, depth)
    assert found.force[2:] == pytest.approx(changed.force[2:], rel=1e-9)
    assert found.force[1] == pytest.approx(2.0 * like.force[1] * np.exp(0.03), rel=1e-9)  # as at the first
    assert found.log_speed[:, 0] == pytest.approx(changed.log_speed[:, 0])
    np.testing.assert_allclose(found.log_speed[:, 1], np.where(depth == 1.0, np.nan, changed.log_speed[:, 1]))


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
        levels = Levels(
            force=force,
            depth=depth,
            swe_mean_m_per_s=nan,
            swe_sd_m_per_s=nan,
            swe_pixels=nan,
            phase=("load",) * n,
            hold=one,
            probe_travel=nan,
            skin_bone=nan,
            path=Path("x"),
        )
        numerics = NumericalChecks(
            None, None, levels, Book(), out=Path(), size=5.0, notes=None, progress=None
        )
        assert numerics.likely_m == m


def test_doubt_that_is_a_large_part_of_the_force_is_warned_of():
    def tried(name: str, change: float) -> Intervention:
        return Intervention(name, np.array([0.0, change]), np.zeros((2, 0)), 1.0)

    assert large_uncertainty([tried("contact", -0.12), tried("locking", 0.9)]) is None
    estimates = large_uncertainty([tried("contact", -0.3), tried("f-kappa", 0.22), tried("crop", 0.01)])
    assert estimates is not None
    assert "contact 35 %, f-kappa 25 %" in estimates
