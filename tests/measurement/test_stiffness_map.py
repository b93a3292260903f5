"""The stiffness map: right where measured, the median where not, smooth between."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.fitting.stiffness_map import stiffness_at
from limbcli.measurement.elastography import SweMap


def swe_map(speed=lambda x, z: 1.5 + 0.05 * z) -> SweMap:
    lateral, depth = (each.ravel() for each in np.meshgrid(np.arange(-20, 21.0), np.arange(2, 26.0)))
    return SweMap(lateral, depth, speed(lateral, depth))


def test_uniform_map_gives_c_everywhere(rng):
    points = rng.uniform(-60, 60, (50, 3))
    c, _, _ = stiffness_at(swe_map(lambda x, z: np.full_like(x, 2.0)), points)
    np.testing.assert_allclose(c, 2 * 1000 * 2.0**2 * 1e-6, rtol=1e-12)


def test_value_inside_is_that_of_the_pixel_under_it():
    points = np.array([[3.0, 0.0, -10.0], [-7.5, 4.0, -18.5]])
    c, inside, _ = stiffness_at(swe_map(), points)
    speed = 1.5 + 0.05 * np.array([10.0, 18.5])
    # the average over 3 mm of a speed that is linear in depth keeps c to the curvature of its logarithm
    np.testing.assert_allclose(c, 2e-3 * speed**2, rtol=0.02)
    assert inside.all()


@pytest.mark.slow
def test_far_outside_is_the_median_and_the_way_there_has_no_step():
    swe = swe_map()
    x = np.linspace(0, 80, 400)
    c, inside, median = stiffness_at(swe, np.column_stack([x, np.zeros(400), np.full(400, -24.0)]))
    assert not inside[-1]
    assert inside[0]
    assert c[-1] == pytest.approx(median, rel=1e-9)
    assert c[-1] == pytest.approx(2e-3 * np.median(swe.speed_m_per_s) ** 2, rel=0.02)
    assert np.abs(np.diff(c)).max() < 0.03 * (c.max() - c.min()) + 1e-6


def test_too_few_pixels_and_a_line_of_pixels_are_refused():
    few = SweMap(np.arange(4.0), np.arange(4.0), np.full(4, 2.0))
    with pytest.raises(MeasurementError, match="4 pixels"):
        stiffness_at(few, np.zeros((1, 3)))
    line = SweMap(np.arange(40.0), np.full(40, 5.0), np.full(40, 2.0))
    with pytest.raises(MeasurementError, match="one line"):
        stiffness_at(line, np.zeros((1, 3)))
