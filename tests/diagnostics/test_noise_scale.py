"""How large an assumed error is, found from a residual: where it is small, where it is as assumed."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnostics.model import noise_scale
from limbcli.diagnostics.model.noise import Noise, NoisePart, independent
from limbcli.diagnostics.model.noise_scale import likeliest_factors, likeliest_share

N = 400
BESIDE = "beside"


def noise() -> Noise:
    """Of all data 1; of the second half 5 more, as assumed."""
    assumed = np.where(np.arange(N) < N // 2, 0.0, 5.0)
    return Noise(
        (independent("own", np.ones(N), source="repeats"), independent(BESIDE, assumed, source="assumed"))
    )


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_the_share_that_made_the_data_is_found(share: float, rng: np.random.Generator):
    columns = np.stack([np.ones(N), np.linspace(-1.0, 1.0, N)], axis=1)
    found = []
    for _ in range(20):
        covariance = noise().with_share(BESIDE, share).covariance
        data = columns @ [3.0, -2.0] + rng.standard_normal(N) * np.sqrt(np.diag(covariance))
        weight = np.sqrt(1.0 / np.diag(covariance))
        fitted = columns @ np.linalg.lstsq(columns * weight[:, None], data * weight, rcond=None)[0]
        found.append(likeliest_share(data - fitted, columns, noise(), BESIDE, least=0.1))
    assert np.mean(found) == pytest.approx(share, rel=0.05)


def test_fitted_parameters_are_allowed_for(rng: np.random.Generator):
    """With half as many parameters as there are data the residual is small, and yet the share is 1."""
    columns = rng.standard_normal((N, N // 2))
    covariance = noise().covariance
    found = []
    for _ in range(10):
        data = rng.standard_normal(N) * np.sqrt(np.diag(covariance))
        weight = np.sqrt(1.0 / np.diag(covariance))
        fitted = columns @ np.linalg.lstsq(columns * weight[:, None], data * weight, rcond=None)[0]
        found.append(likeliest_share(data - fitted, columns, noise(), BESIDE, least=0.1))
    assert np.mean(found) > 0.9


def test_it_stays_between_its_ends_and_says_where_it_is_from(rng: np.random.Generator):
    columns = np.ones((N, 1))
    assert likeliest_share(np.zeros(N), columns, noise(), BESIDE, least=0.1) == pytest.approx(0.1)
    assert likeliest_share(np.full(N, 50.0), np.zeros((N, 1)), noise(), BESIDE, least=0.1) == 1.0
    assert likeliest_share(np.ones(N), columns, noise(), "absent", least=0.1) == 1.0
    smaller = noise().with_share(BESIDE, 0.5)
    assert [part.source for part in smaller.parts] == ["repeats", "estimated"]
    assert smaller.covariance[-1, -1] == pytest.approx(1 + 2.5**2)


GROUPS = [f"part {k}" for k in range(N // 10) for _ in range(10)]


def growing() -> Noise:
    """Of all data 1; of each ten of them 4 more, alike in the ten."""
    alike = 16.0 * np.kron(np.eye(N // 10), np.ones((10, 10)))
    return Noise((independent("own", np.ones(N), source="repeats"), NoisePart(BESIDE, alike, "assumed")))


def test_parts_that_stand_out_are_found_and_no_others(rng: np.random.Generator):
    columns = np.stack([np.ones(N), np.linspace(-1.0, 1.0, N)], axis=1)
    most, others = [], []
    for _ in range(20):
        data = rng.standard_normal(N)
        data[30:40] += 3.0
        data[200:210] -= 2.0
        off = data - columns @ np.linalg.lstsq(columns, data, rcond=None)[0]
        found = likeliest_factors(off, columns, growing(), BESIDE, GROUPS, gain=4.0)
        most.append([found[30], found[200]])
        others.append(np.delete(found.reshape(-1, 10)[:, 0], [3, 20]))
    assert np.mean(most, axis=0) == pytest.approx([3.0 / 4.0, 2.0 / 4.0], rel=0.1)
    assert np.count_nonzero(others) <= 3  # of 20 draws


def test_the_gain_of_a_factor_is_that_of_the_restricted_likelihood(rng: np.random.Generator):
    """By eigenvalues of the group's own data, and by the whole covariance."""
    columns = rng.standard_normal((60, 3))
    at = np.arange(20, 30)
    part = np.zeros((60, 60))
    part[np.ix_(at, at)] = 4.0 * 0.8 ** np.abs(np.subtract.outer(at, at))
    covariance = np.diag(rng.uniform(0.5, 2.0, 60))
    residual = rng.standard_normal(60)
    residual[at] += 2.5
    inverse = np.linalg.inv(covariance)
    seen = inverse @ columns
    free = inverse - seen @ np.linalg.inv(columns.T @ seen) @ seen.T
    grown, factor = noise_scale._best_factor(residual, free, part, at)

    def likelihood(f: float) -> float:
        return -noise_scale._restricted(residual, columns, covariance + f**2 * part)

    assert grown == pytest.approx(likelihood(factor) - likelihood(0.0), abs=1e-9)
    assert all(likelihood(factor) >= likelihood(f) - 1e-6 for f in np.linspace(0.0, 1.0, 21))


def test_noise_has_no_part_that_stands_out(rng: np.random.Generator):
    columns = np.ones((N, 1))
    found = [
        likeliest_factors(rng.standard_normal(N), columns, growing(), BESIDE, GROUPS, gain=4.0).any()
        for _ in range(40)
    ]
    assert np.mean(found) < 0.2
    assert not likeliest_factors(np.full(N, 9.0), columns, growing(), "absent", GROUPS, gain=4.0).any()
