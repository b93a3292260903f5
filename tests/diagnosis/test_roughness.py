"""Scatter is what no smooth curve along a series explains; parts of a map are series of their own."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnosis.explanations.forward_model import Data
from limbcli.diagnosis.explanations.noise import LinearFit, Noise, independent
from limbcli.diagnosis.explanations.residuals import roughness
from limbcli.numbers.whitening import Whitener

N_LEVELS, PARTS = 9, 4


def data(y: np.ndarray, *, by_part: bool) -> Data:
    level = np.tile(np.arange(N_LEVELS, dtype=float), PARTS)
    series = tuple(f"map {k}" for k in range(PARTS) for _ in range(N_LEVELS))
    noise = Noise((independent("own", np.ones(len(y)), source="repeats"),))
    return Data(y, ("map",) * len(y), level, noise, series=series if by_part else ())


def found(y: np.ndarray, *, by_part: bool):
    estimates = data(y, by_part=by_part)
    whiten = Whitener.of(estimates.noise.covariance)
    state = LinearFit.of(whiten(y), np.ones((len(y), 1)))
    return roughness(state, whiten, series=estimates.all_series(), order=estimates.order)


def test_parts_that_differ_smoothly_are_no_scatter(rng):
    t = np.linspace(0, 1, N_LEVELS)
    pattern = np.concatenate([8 * (k - 1.5) * (1 + t) for k in range(PARTS)])
    y = pattern + rng.standard_normal(len(pattern))
    assert found(y, by_part=True).p > 0.01
    assert found(y, by_part=False).p < 1e-6


def test_scatter_within_a_part_is_found(rng):
    y = 3.0 * rng.standard_normal(N_LEVELS * PARTS)
    assert found(y, by_part=True).p < 1e-3
    assert found(y, by_part=True).ratio == pytest.approx(9.0, rel=0.6)
