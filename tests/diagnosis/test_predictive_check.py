"""The check of a residual: rare under the model, and what is off is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.forward_model import Data
from limbcli.diagnosis.explanations.noise import LinearFit, Noise, independent, unit_errors
from limbcli.diagnosis.explanations.residuals import WHOLE, Check, checked
from limbcli.numbers.whitening import Whitener
from tests.diagnosis import toy


def of(data: Data, y: np.ndarray, seed: int = 1) -> Check:
    """Of the toy's data in place of its own, with a fit of its three parameters."""
    whiten = Whitener.of(data.noise.covariance)
    state = LinearFit.of(whiten(y), whiten(toy.BASE))
    return checked(replace(data, y=y), state, whiten, np.random.default_rng(seed))


@pytest.mark.slow
def test_under_the_model_a_hundredth_of_the_data_fails(rng, monkeypatch):
    """Adjusted over six tests that share their data: the smallest p is below 1 % in 1 %, as below 10 % in
    10 %. Of 1500, with 2000 draws, which know 1 % to 0.2 %: 3 % in place of 1 would pass with 9 %, 3.5 %
    with 1 %."""
    monkeypatch.setattr(decisions, "N_DRAWS_OF_PARTS", 2000)
    data = toy.make(rng).data
    root, n = np.linalg.cholesky(data.noise.covariance), 1500
    p = np.array([of(data, root @ unit_errors(rng, (len(data),)), k).p for k in range(n)])
    for level in (decisions.CHECKED, 0.1):
        low, high = binom.ppf([1e-4, 1 - 1e-4], n, [0.8 * level, 1.2 * level])
        assert low <= np.sum(p < level) <= high


def test_a_part_that_is_shifted_is_found_and_named(rng):
    data = toy.make(rng).data
    late = data.groups["late force"]
    found = of(data, rng.standard_normal(len(data)) + np.where(late, [3.0, -3.0] * 12, 0.0))
    least = min(found.parts, key=lambda each: each.p_adjusted)
    assert least.name == "late force"
    assert found.p < decisions.CHECKED
    assert max(each.p for each in found.parts if each.name in ("speed", "late speed", "early force")) > 0.05


def test_the_whole_comes_first_with_its_own_chi2(rng):
    data = toy.make(rng).data
    y = rng.standard_normal(len(data))
    found = of(data, y)
    whiten = Whitener.of(data.noise.covariance)
    left = LinearFit.of(whiten(y), whiten(toy.BASE))
    whole = found.parts[0]
    assert (whole.name, whole.nu) == (WHOLE, len(data) - 3)
    assert whole.chi2 == pytest.approx(left.chi2)
    assert [each.name for each in found.parts[1:]] == list(data.groups)
    # heavier tails than normal ones: a little above the p of chi2
    assert 0.0 <= whole.p - chi2.sf(left.chi2, left.nu) < 0.15 or whole.p > 0.3
    assert all(each.p <= each.p_adjusted <= 1.0 for each in found.parts)
    assert found.p == min(each.p_adjusted for each in found.parts)


def test_a_part_counts_what_the_fitted_parameters_cannot_reproduce():
    """The two data that a parameter moves alone are not free to be off: one of their shifts is that
    parameter."""
    noise = Noise((independent("own", np.ones(6), source="spec"),))
    groups = {
        "two": np.arange(6) < 2,
        "rest": np.arange(6) >= 2,
        "all": np.ones(6, bool),
        "none": np.zeros(6, bool),
    }
    data = Data(np.zeros(6), ("force",) * 6, np.arange(6.0), noise, groups)
    whiten = Whitener.of(noise.covariance)
    J = np.array([[1.0, 1.0, 0, 0, 0, 0]]).T
    found = checked(
        data, LinearFit.of(np.array([1.0, -1.0, 0, 0, 2.0, 0]), J), whiten, np.random.default_rng(1)
    )
    parts = {each.name: (each.nu, each.chi2) for each in found.parts}
    assert parts == {
        "whole": (5, pytest.approx(6.0)),
        "two": (1, pytest.approx(2.0)),
        "rest": (4, pytest.approx(4.0)),
    }


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
def test_a_large_part_is_shifted_as_evenly_as_levels_and_places_go_on(shift, explained, rng):
    """Whatever level and place are counted from: all of an even shift is seen, of scatter next to nothing."""
    data, group = images(rng)
    off = np.where(group, shift(data.order, *data.place.T), 0.0)
    whiten, none = Whitener(np.eye(len(off))), np.zeros((len(off), 0))
    half = checked(data, LinearFit.of(off, none), whiten, np.random.default_rng(1)).parts[1]
    found = half.chi2 / (off @ off)
    assert found == pytest.approx(1.0) if explained == 1.0 else found < explained
    assert half.nu == 9
    beside = LinearFit.of(np.where(group, 0.0, shift(data.order, *data.place.T)), none)
    assert checked(data, beside, whiten, np.random.default_rng(1)).parts[1].chi2 == pytest.approx(
        0.0, abs=1e-12
    )
