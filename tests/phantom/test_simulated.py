"""From a simulated indentation to true levels, on a uniform compression worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import SolveError
from limbcli.phantom.protocol import LoadingProtocol
from limbcli.phantom.simulated import Indentation, true_levels
from limbcli.shear_waves.ogden import OgdenTerms
from limbcli.shear_waves.speed import wave_speed_m_per_s

THICKNESS = 40.0


def speed_in_tissue(F, _):
    return wave_speed_m_per_s(F, OgdenTerms.one_pair(c=0.008, m=2.0))


def uniform(rng, stiffness=1.2, n=20_000):
    """A 40 mm layer squeezed uniformly along z, bulging along y only; the force is linear."""
    rest = rng.uniform([-30, -10, -THICKNESS], [30, 10, 0], (n, 3))
    depth = np.linspace(0, 12, 13)
    stretch = 1 - depth / THICKNESS
    zeros, ones = np.zeros_like(stretch), np.ones_like(stretch)
    F = np.stack([np.stack([ones, zeros, zeros], 1), np.stack([zeros, 1 / stretch, zeros], 1),
                  np.stack([zeros, zeros, stretch], 1)], axis=1)  # fmt: skip
    F = np.broadcast_to(F[:, None], (13, n, 3, 3))
    positions = np.stack([rest + (rest[:, 2] + THICKNESS)[:, None] * [0, 0, s - 1] for s in stretch])
    positions[:, :, 1] = rest[:, 1] / stretch[:, None]
    return Indentation(depth, stiffness * depth, positions, F)


@pytest.mark.slow
def test_levels_follow_the_force_steps_and_the_closed_form_speed(rng):
    true = true_levels(
        uniform(rng), speed_in_tissue, protocol=LoadingProtocol(max_force=10.0), skin_bone=THICKNESS
    )
    assert true.force.tolist() == [0, 2, 4, 6, 8, 10]
    assert true.depth == pytest.approx(true.force / 1.2, abs=1e-9)
    for depth, swe in zip(true.depth, true.maps, strict=True):
        l_z = 1 - depth / THICKNESS
        modulus = 0.008 / 4 * (1 + l_z**-2)  # m = 2, l_x = 1
        speed = np.sqrt(modulus / 1e-9) / 1e3
        assert swe.speed_m_per_s == pytest.approx(speed, rel=2e-4)
        assert len(swe) == 25 * 24


def test_levels_end_where_the_simulation_ends(rng):
    true = true_levels(
        uniform(rng, stiffness=0.6), speed_in_tissue, protocol=LoadingProtocol(), skin_bone=None
    )
    assert true.force[-1] == 6.0
    with pytest.raises(SolveError, match="2 levels"):
        true_levels(uniform(rng, stiffness=0.2), speed_in_tissue, protocol=LoadingProtocol(), skin_bone=None)
