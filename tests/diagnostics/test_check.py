"""Where a misfit lies: groups of data, and each part predicted by the rest."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Data
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.model.noise import Noise, independent
from limbcli.diagnostics.statistical_tests.localisation_tests import group_trials, predicted_without
from limbcli.diagnostics.statistical_tests.score import score


def images(rng: np.random.Generator, n: int = 160) -> tuple[Data, np.ndarray]:
    """Levels 3 to 12 of an image, the first half of whose data is a group; and what is imaged where."""
    order, place = rng.integers(3, 13, n).astype(float), rng.uniform([-20.0, 4.0], [15.0, 24.0], (n, 2))
    group = np.arange(n) < n // 2
    noise = Noise((independent("own", np.ones(n), source="repeats"),))
    return Data(np.zeros(n), ("map",) * n, order, noise, groups={"half": group}, place=place), group


@pytest.mark.parametrize(
    ("shift", "explained"),
    [
        (lambda t, x, z: 3.0 + 0 * t, 1.0),
        (lambda t, x, z: (t - 5.0) ** 2, 1.0),
        (lambda t, x, z: t**2 * (x - 0.4 * z) + t * z, 1.0),
        (lambda t, x, z: np.sin(40.0 * t + 3.0 * x), 0.3),
    ],
)
def test_a_large_group_is_shifted_as_evenly_as_levels_and_places_go_on(shift, explained, rng):
    """Whatever level and place are counted from: all of an even shift is seen, of scatter next to nothing."""
    data, group = images(rng)
    assert group.sum() > thresholds.FEW_DATA
    off = np.where(group, shift(data.order, *data.place.T), 0.0)
    state = LinearFit.of(off, np.zeros((len(off), 0)))
    (trial,) = group_trials(Whitener(np.eye(len(off))), data)
    found = score(state, trial).statistic / (off @ off)
    assert found == pytest.approx(1.0) if explained == 1.0 else found < explained
    beside = LinearFit.of(np.where(group, 0.0, shift(data.order, *data.place.T)), state.jacobian)
    assert score(beside, trial).statistic == pytest.approx(0.0, abs=1e-12)


def test_what_is_left_out_is_predicted_as_by_a_shift_of_its_own(rng):
    """With noise that data share: z is a shift of that datum alone over its deviation, fitted to all data."""
    n = 8
    jacobian, root = rng.standard_normal((n, 2)), rng.standard_normal((n, n))
    covariance, residual = root @ root.T + 0.5 * np.eye(n), rng.standard_normal(n)
    inverse = np.linalg.inv(covariance)
    for k in (0, 5):
        columns = np.column_stack([jacobian, np.eye(n)[k]])
        known = np.linalg.inv(columns.T @ inverse @ columns)
        shift = (known @ columns.T @ inverse @ residual)[-1] / np.sqrt(known[-1, -1])
        found = predicted_without(residual, jacobian, covariance, np.arange(n) == k)
        assert found == pytest.approx((abs(shift), abs(shift)))
    both = predicted_without(residual, jacobian, covariance, np.isin(np.arange(n), (0, 5)))
    assert both[0] < both[1] < both[0] * np.sqrt(2.0)
