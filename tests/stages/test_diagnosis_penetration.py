"""A probe that sinks into the model's skin: what two penalties tell of a hard contact."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnosis.curves.curve_plan import Solving
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.mesh_error.mesh_correction import Penetration, penetration
from limbcli.effects import effect
from limbcli.effects.curves import Curves, log_force_at
from tests.stages import block_case

DEPTHS = (0.5, 1.0, 2.0, 3.0, 4.0)
SOFTER = ((effect("contact"), {"penalty_factor": 0.25}),)
HARDER = ((effect("contact"), {"penalty_factor": 16.0}),)


@pytest.fixture(scope="module")
def simulations():
    block = block_case.block_model(counts=(4, 2, 2))
    made = SiteSimulations(block, DEPTHS, c=0.006, f_kappa=2.0, solving=Solving(tolerance=1e-6, threads=1))
    yield made
    made.close()


@pytest.mark.parametrize("m", [2.0, 10.0])
def test_what_is_left_of_the_gap_is_taken_away(simulations, m):
    usual, hard = simulations.curves(m), simulations.curves(m, HARDER)
    found = penetration(simulations.curves(5.0), simulations.curves(5.0, SOFTER))
    assert found is not None
    mended = found.without(usual, usual.force)
    at = np.array(DEPTHS[1:-1])
    before = log_force_at(usual, at) - log_force_at(hard, at)
    after = log_force_at(mended, at) - log_force_at(hard, at)
    assert np.abs(before).max() > 0.01
    assert np.abs(after).max() < 0.5 * np.abs(before).max()


def test_a_known_gap_in_series_with_the_tissue():
    """A probe that sinks in by F/s is deeper by that at a force; with a quarter of the penalty, by 4 F/s."""
    depth = np.linspace(0.0, 6.0, 25)
    force = 0.5 * depth**2
    share = 0.5  # of what a quarter of the penalty adds, 3 F/s: a third of it would be exact
    curves = {
        times: Curves(depth + times * 0.01 * force, force, np.zeros((25, 0)), np.zeros(0)) for times in (1, 4)
    }
    found = penetration(curves[1], curves[4])
    assert found is not None
    np.testing.assert_allclose(found.at(force[4:]), share * 0.03 * force[4:], rtol=0.01)
    np.testing.assert_allclose(found.at(2 * force[-1]), 2 * found.at(force[-1]))


def test_forces_that_do_not_differ_tell_nothing():
    same = Curves(np.arange(4.0), np.arange(4.0), np.zeros((4, 0)), np.zeros(0))
    assert penetration(same, same) is None


def test_depths_stay_in_order_however_steep_the_force():
    curves = Curves(np.arange(4.0), np.array([0.0, 1.0, 50.0, 5000.0]), np.zeros((4, 0)), np.zeros(0))
    shifted = Penetration(np.array([0.0, 1.0]), np.array([0.0, 0.1])).without(curves, curves.force)
    assert np.all(np.diff(shifted.depth) > 0)


def test_what_a_softer_contact_takes_is_what_it_was_seen_to_take(simulations):
    """The same pair of simulations, forward: from the hard contact's curve to the softer one's."""
    usual, softer = simulations.curves(5.0), simulations.curves(5.0, SOFTER)
    found = penetration(usual, softer)
    assert found is not None
    hard = found.without(usual, usual.force)
    for penalty, theirs in ((1.0, usual), (0.25, softer)):
        at = np.array([3.0])
        seen = 1.0 - np.exp(log_force_at(theirs, at) - log_force_at(hard, at))[0]
        assert found.taken(hard, hard.force, 3.0, penalty=penalty) == pytest.approx(seen, rel=0.15)
