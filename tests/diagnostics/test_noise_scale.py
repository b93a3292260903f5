"""How large an assumed error is, found from a residual: where it is small, where it is as assumed."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnostics.model.noise import Noise, independent
from limbcli.diagnostics.model.noise_scale import likeliest_share

N = 400
BESIDE = "beside"


def noise() -> Noise:
    """Of all data 1; of the second half 5 more, as assumed."""
    assumed = np.where(np.arange(N) < N // 2, 0.0, 5.0)
    return Noise(
        (independent("own", np.ones(N), source="repeats"), independent(BESIDE, assumed, source="assumed"))
    )


@pytest.mark.slow
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


@pytest.mark.slow
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
