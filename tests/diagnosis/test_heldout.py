"""Predicting what was left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.diagnosis.explanations.forward_model import Data, Fitted
from limbcli.diagnosis.explanations.noise import Noise, NoisePart
from limbcli.diagnosis.explanations.residuals import held_out_error, over_shared

N = 30  # data in each of two blocks, of deviation 1


def data(rng) -> Data:
    first = np.arange(2 * N) < N
    noise = Noise((NoisePart("own", np.eye(2 * N), "repeats"),))
    y = rng.standard_normal(2 * N)
    return Data(y, ("map",) * 2 * N, np.arange(2.0 * N), noise, blocks={"first": first, "second": ~first})


def fitted(given: Data, jacobian: np.ndarray) -> Fitted:
    """Least squares: what a full fit leaves."""
    return Fitted((), jacobian @ np.linalg.lstsq(jacobian, given.y, rcond=None)[0], jacobian, ("c",), {})


def test_what_the_rest_tells_well_is_predicted_to_its_own_noise(rng):
    reported = data(rng)
    found = held_out_error(reported, fitted(reported, np.ones((2 * N, 1))))
    assert set(found) == {"first", "second", "all"}
    assert found["all"] == pytest.approx(1.0, abs=0.25)


def test_the_error_is_a_root_mean_square_over_data():
    """A level fitted to 0, 0 and 6 in blocks of 20, 20 and 10 data: the rest tells 2, 2 and 0 of them."""
    sizes = np.array([20, 20, 10])
    block = np.repeat(np.arange(3), sizes)
    noise, n = Noise((NoisePart("own", np.eye(50), "repeats"),)), np.arange(50.0)
    blocks = {name: block == k for k, name in enumerate("abc")}
    reported = Data(6.0 * (block == 2), ("map",) * 50, n, noise, blocks=blocks)
    found = held_out_error(reported, fitted(reported, np.ones((50, 1))))
    assert found == pytest.approx({"a": 2.0, "b": 2.0, "c": 6.0, "all": np.sqrt(sizes @ [4, 4, 36] / 50)})
    wider = replace(reported, noise=Noise((NoisePart("own", 4.0 * np.eye(50), "repeats"),)))
    assert held_out_error(wider, fitted(wider, np.ones((50, 1))))["all"] == pytest.approx(found["all"] / 2)


@pytest.mark.parametrize(("grows", "tested"), [(2.0, True), (8.0, False)])
def test_a_block_that_tells_a_parameter_itself_says_nothing_of_the_model(rng, grows, tested):
    """A parameter that moves the first block `grows` times as far as the second: known from the second alone
    to 1 / sqrt(30), the first is predicted to `grows` / sqrt(30) of its own deviation."""
    column = np.where(np.arange(2 * N) < N, grows, 1.0)[:, None]
    reported = data(rng)
    found = held_out_error(reported, fitted(reported, column))
    assert ("first" in found) == tested
    assert "second" in found


def test_a_block_is_not_predicted_by_a_rest_that_does_not_tell_a_parameter(rng):
    """The second half does not depend on the first parameter: what it predicts of the first is anything."""
    reported = data(rng)
    alone = np.where(reported.blocks["first"], np.arange(2.0 * N), 1e-12)
    model = fitted(reported, np.stack([alone, np.ones(2 * N)], axis=1))
    assert set(held_out_error(reported, model)) == {"second", "all"}


def test_an_error_that_the_rest_shows_is_not_held_against_the_model(rng):
    """Both blocks have a gain in common, ten deviations large: off by that, they are predicted from one
    another to their own noise."""
    reported = data(rng)
    both = np.ones(2 * N)
    noise = Noise((*reported.noise.parts, NoisePart("gain", 100.0 * np.outer(both, both), "assumed")))
    shifted = replace(reported, y=reported.y + 10.0, noise=noise)
    column = np.linspace(-1.0, 1.0, 2 * N)[:, None]
    model = Fitted((), np.zeros(2 * N), column, ("m",), {})
    found = held_out_error(shifted, model)
    assert found["all"] == pytest.approx(1.0, abs=0.3)


def test_errors_of_two_models_are_over_the_same_data():
    """Of three blocks of three data the second model cannot predict the last."""
    blocks = {name: np.arange(9) // 3 == k for k, name in enumerate("abc")}
    first = {"a": 2.0, "b": 4.0, "c": 9.0, "all": 5.8}
    before, after = over_shared([first, {"a": 1.0, "b": 1.0, "all": 1.0}], blocks)
    assert before["all"] == np.sqrt((3 * 4.0 + 3 * 16.0) / 6)
    assert after["all"] == 1.0
    assert before["c"] == 9.0
    assert over_shared([{"a": 1.0, "all": 1.0}, {}], blocks) == [{"a": 1.0, "all": 1.0}, {}]
