"""Placebos: arbitrary smooth directions, and how much better than they an explanation has to be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.statistical_tests.placebo import (
    library_percentile,
    placebo_percentile,
    smooth_directions,
)

N = 14
ORDER = np.r_[np.arange(8.0), np.arange(6.0)]
CHANNELS = {"force": np.arange(N) < 8, "speed": np.arange(N) >= 8}
DEVIATION = np.linspace(0.5, 2.0, N)
WHITEN = Whitener.of(np.diag(DEVIATION**2))


def fit(rng: np.random.Generator) -> LinearFit:
    return LinearFit.of(3.0 * rng.standard_normal(N), rng.standard_normal((N, 2)))


def explained(state: LinearFit, curves: np.ndarray) -> float:
    """Of chi2, by the best combination of these curves (n, N)."""
    columns = state.project(WHITEN(curves.T))
    return float(state.chi2 - np.linalg.lstsq(columns, state.left, rcond=None)[1][0])


def test_smooth_directions_are_four_waves_along_each_channel_whatever_levels_are_counted_from(rng):
    seven, again = (
        smooth_directions(CHANNELS, order, DEVIATION, 7, np.random.default_rng(3))
        for order in (ORDER, 20.0 - 2.5 * ORDER)
    )
    flipped = np.array([1.0, -1.0, 1.0, -1.0])  # an order that falls turns the odd waves over
    t = ORDER[:8] / 7
    waves = np.cos(np.pi * np.outer(np.arange(4), t)).T
    first, other = (
        np.linalg.lstsq(waves, (each / DEVIATION)[:, :8].T, rcond=None) for each in (seven, again)
    )
    assert first[1] == pytest.approx(0.0, abs=1e-20)
    np.testing.assert_allclose(other[0].T, first[0].T * flipped, atol=1e-12)
    assert not np.allclose(seven[:, :6] / DEVIATION[:6], seven[:, 8:] / DEVIATION[8:])


@pytest.mark.parametrize("n_parameters", [1, 2])
def test_what_is_smooth_by_chance_is_as_often_above_as_below_placebos(n_parameters, rng, monkeypatch):
    monkeypatch.setattr(thresholds, "N_PLACEBOS", 300)
    found = []
    for k in range(60):
        state, own = fit(rng), smooth_directions(CHANNELS, ORDER, DEVIATION, n_parameters, rng)
        found.append(
            placebo_percentile(state, WHITEN, explained(state, own), n_parameters=n_parameters,
                               channels=CHANNELS, order=ORDER, deviation=DEVIATION,
                               rng=np.random.default_rng(k))
        )  # fmt: skip
    assert stats.kstest(np.array(found) / 100.0, "uniform").pvalue > 0.01


def test_the_best_of_many_by_chance_is_compared_with_the_best_of_as_many(rng):
    found = []
    for k in range(40):
        state = fit(rng)
        best = max(
            explained(state, each[None]) for each in smooth_directions(CHANNELS, ORDER, DEVIATION, 9, rng)
        )
        found.append(
            library_percentile(state, WHITEN, best, n_parameters=1, n_tried=9, channels=CHANNELS, order=ORDER,
                               deviation=DEVIATION, rng=np.random.default_rng(k))
        )  # fmt: skip
    assert stats.kstest(np.array(found) / 100.0, "uniform").pvalue > 0.01
