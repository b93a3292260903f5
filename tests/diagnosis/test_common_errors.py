"""Errors common to many data: what a fit makes of them, against the fit with one more parameter for each."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnosis import written_result
from limbcli.diagnosis.data.noise_parts import COMPRESSIBILITY
from limbcli.diagnosis.explanations.noise import (
    CommonError,
    LinearFit,
    Noise,
    common,
    common_errors,
    correlated,
    independent,
)
from limbcli.numbers.whitening import Whitener

N = 40


@pytest.fixture
def noise(rng: np.random.Generator) -> Noise:
    return Noise((
        independent("own", rng.uniform(0.5, 2.0, N), source="repeats"),
        correlated("mesh", np.full(N, 0.7), np.arange(N, dtype=float), correlation=0.8, source="computed"),
        common("gain", rng.standard_normal(N), source="assumed"),
        common("compressibility", 3.0 * rng.standard_normal(N), source="computed"),
        common("nothing", np.zeros(N), source="computed"),
    ))  # fmt: skip


def fit(noise: Noise, y: np.ndarray, J: np.ndarray) -> tuple[LinearFit, Whitener]:
    whiten = Whitener.of(noise.covariance)
    return LinearFit.of(whiten(y), whiten(J)), whiten


def test_exact_the_fit_with_one_more_parameter_for_each(noise: Noise, rng: np.random.Generator) -> None:
    """Parameters, chi2, estimates and their deviations are those of least squares with priors as rows."""
    J, y = rng.standard_normal((N, 3)), 5.0 * rng.standard_normal(N)
    state, whiten = fit(noise, y, J)
    single = [part.direction for part in noise.parts[2:4]]
    rest = Whitener.of(noise.parts[0].covariance + noise.parts[1].covariance)
    top = np.hstack([rest(J), rest(np.stack(single, axis=1))])
    A = np.vstack([top, np.hstack([np.zeros((2, 3)), np.eye(2)])])
    b = np.concatenate([rest(y), np.zeros(2)])
    x, _, _, _ = np.linalg.lstsq(A, b, rcond=None)
    deviation = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    found = common_errors(noise, whiten, state)
    assert [each.name for each in found] == ["gain", "compressibility"]
    assert [each.value for each in found] == pytest.approx(x[3:], rel=1e-9)
    assert [each.deviation for each in found] == pytest.approx(deviation[3:], rel=1e-9)
    assert np.linalg.pinv(state.jacobian) @ state.residual == pytest.approx(x[:3], rel=1e-9)
    assert state.chi2 == pytest.approx(float(np.sum((A @ x - b) ** 2)), rel=1e-9)


def test_what_a_parameter_can_reproduce_keeps_its_prior(noise: Noise, rng: np.random.Generator) -> None:
    J = np.stack([noise.parts[3].direction, rng.standard_normal(N)], axis=1)
    state, whiten = fit(noise, rng.standard_normal(N), J)
    found = common_errors(noise, whiten, state)[1]
    assert (found.value, found.deviation) == pytest.approx((0.0, 1.0), abs=1e-9)


def test_a_part_of_another_size_is_estimated_in_its_own_deviations(
    noise: Noise, rng: np.random.Generator
) -> None:
    y, J = 5.0 * rng.standard_normal(N), rng.standard_normal((N, 2))
    half = noise.with_share("compressibility", 0.5)
    by_hand = noise.with_parts(
        [*noise.parts[:3], common("compressibility", 0.5 * noise.parts[3].direction, source="computed")]
    )
    for each, other in zip(*(_found(one, y, J) for one in (half, by_hand)), strict=True):
        assert each == other


def _found(noise: Noise, y: np.ndarray, J: np.ndarray) -> tuple[CommonError, ...]:
    state, whiten = fit(noise, y, J)
    return common_errors(noise, whiten, state)


def test_f_kappa_is_no_surer_than_other_errors_let_it_be() -> None:
    sure = written_result.f_kappa_estimate([CommonError(COMPRESSIBILITY, 0.0, 0.01)])
    assert sure is not None
    assert sure["value"] == 100.0
    assert sure["prior_95"][1] is None
    low, high = sure["interval_95"]
    assert sure["prior_95"][0] < low < 55.0
    assert high is None
    assert 1 / low - 1 / 100.0 == pytest.approx(0.0075 * 1.96 * written_result._F_KAPPA_ERROR, rel=1e-3)


def test_f_kappa_of_which_the_data_say_nothing_has_its_prior() -> None:
    unknown = written_result.f_kappa_estimate(
        [CommonError("gain", 2.0, 0.1), CommonError(COMPRESSIBILITY, 0.0, 1.0)]
    )
    assert unknown is not None
    assert unknown["interval_95"] == unknown["prior_95"]
    assert written_result.f_kappa_estimate([CommonError("gain", 2.0, 0.1)]) is None
