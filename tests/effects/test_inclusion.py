"""The ball of an inclusion, place by place."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.effects import inclusion
from limbcli.effects.stiffness_places import Places


@pytest.mark.parametrize(("log_ratio", "edge"), [(1.5, 1.0), (-2.0, 2.5)])
def test_stiffness_is_a_smooth_ball(log_ratio: float, edge: float, rng: np.random.Generator) -> None:
    """1 + (ratio - 1) / (1 + 81^((distance - radius) / edge)), whatever the shape of the places' array."""
    theta = {
        "log_inclusion_ratio": log_ratio, "inclusion_x_mm": 3.0, "inclusion_depth_mm": 8.0,
        "inclusion_radius_mm": 5.0, "inclusion_edge_mm": edge,
    }  # fmt: skip
    at = rng.uniform(-25.0, 25.0, (7, 30, 3))
    at[0, 0], at[0, 1] = (3.0, 0.0, -8.0), (8.0, 0.0, -8.0)
    away = np.linalg.norm(at - (3.0, 0.0, -8.0), axis=-1)
    expected = 1.0 + np.expm1(log_ratio) / (1.0 + 81.0 ** np.minimum((away - 5.0) / edge, 150.0))
    found = inclusion.stiffness(Places(at, None), theta)  # type: ignore[arg-type]
    assert found.shape == (7, 30)
    np.testing.assert_allclose(found, expected, atol=1e-8)
    assert found[0, 0] == pytest.approx(np.exp(log_ratio), rel=1e-3)
    assert found[0, 1] == pytest.approx(0.5 * (1.0 + np.exp(log_ratio)))


@pytest.mark.parametrize("edge", [1.0, 3.0, 8.0])
def test_the_edge_is_where_a_tenth_to_nine_tenths_of_the_change_are(edge: float) -> None:
    away = np.array([9.0 - edge / 2, 9.0, 9.0 + edge / 2])
    at = np.stack([away, np.zeros(3), np.full(3, -20.0)], axis=1)
    theta = {
        "log_inclusion_ratio": np.log(3.0), "inclusion_depth_mm": 20.0, "inclusion_radius_mm": 9.0,
        "inclusion_edge_mm": edge,
    }  # fmt: skip
    found = inclusion.stiffness(Places(at, None), theta)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, 1.0 + 2.0 * np.array([0.9, 0.5, 0.1]))
