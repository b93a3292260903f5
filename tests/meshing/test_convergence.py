"""Extrapolation to an infinitely fine mesh."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing.mesh_extrapolation import extrapolate


@pytest.mark.parametrize("order", [1.0, 2.0, 3.3])
def test_order_and_limit_are_found(order, rng):
    sizes = np.array([4.0, 1.7, 2.5])
    found = extrapolate(sizes, 7.0 + 0.2 * sizes**order)
    assert found.limit == pytest.approx(7.0, rel=1e-9)
    assert found.order == pytest.approx(order, rel=1e-6)
    assert not found.order_is_assumed
    assert found.error_fraction == pytest.approx(1.25 * 0.2 * sizes**order / 7.0)


def test_a_zigzag_gets_an_assumed_order_and_a_larger_error():
    found = extrapolate([1.0, 2.0, 4.0], [10.0, 10.2, 10.1])
    assert found.order_is_assumed
    assert found.limit == pytest.approx(10.0 - 0.2 / 3)
    assert found.error_fraction[0] == pytest.approx(3 * (0.2 / 3) / found.limit)
