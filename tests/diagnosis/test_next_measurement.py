"""What a further measurement is expected to say about which explanation is true."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from limbcli.diagnosis.explanations.conclusions import ranked
from limbcli.diagnosis.explanations.forward_model import Fitted, Proposal
from limbcli.diagnosis.explanations.laplace import Posterior
from limbcli.diagnosis.explanations.search import Explained


def member(name: str, probability: float, deviation: float = 0.0, step: float = 0.0) -> Explained:
    """With one parameter, known to this deviation, that is off the fit by a step."""
    fitted = Fitted((name,), np.zeros(1), np.zeros((1, 1)), (), {})
    posterior = Posterior(fitted, 0.0, np.array([step]), np.array([[deviation**2]]), 0.0, {})
    return Explained((name,), probability, 0.0, posterior)


def proposal(name: str, seen: dict[str, float], slope: float = 1.0, n: int = 1) -> Proposal:
    predicted = {(each,): (np.full(n, value), np.full((n, 1), slope)) for each, value in seen.items()}
    return Proposal(name, f"look at {name}", predicted, np.eye(n))


def test_what_separates_two_explanations_is_worth_their_entropy_and_what_sees_nothing_is_worth_none(rng):
    several = [member("a", 0.6), member("b", 0.3)]
    p = np.array([2.0, 1.0]) / 3.0
    entropy = float(-p @ np.log2(p))
    apart, idle = ranked(
        several, [proposal("idle", {"a": 1.0, "b": 1.0}), proposal("apart", {"a": 0.0, "b": 9.0})], rng
    )
    assert (apart.name, idle.name) == ("apart", "idle")
    assert apart.information_bits == pytest.approx(entropy, abs=1e-3)
    assert apart.expected_probability == pytest.approx(1.0, abs=1e-3)
    assert idle.information_bits == pytest.approx(0.0, abs=1e-9)
    assert apart.entropy_bits == idle.entropy_bits == pytest.approx(entropy)
    assert [idle.expected_probability, idle.before] == pytest.approx([float(p @ p)] * 2)


@pytest.mark.parametrize("apart", [1.0, 2.0, 3.5])
def test_its_information_is_that_of_the_integral(apart, rng):
    """600 draws know it to 0.02."""

    def entropy_after(y: float) -> float:
        density = 0.5 * stats.norm.pdf(y, [0.0, apart])
        p = np.maximum(density / density.sum(), 1e-300)
        return float(density.sum() * -(p @ np.log2(p)))

    expected = 1.0 - integrate.quad(entropy_after, -10, 10 + apart, limit=200)[0]
    several = [member("a", 0.5), member("b", 0.5)]
    found = [
        ranked(several, [proposal("x", {"a": 0.0, "b": apart})], rng)[0].information_bits for _ in range(4)
    ]
    assert np.mean(found) == pytest.approx(expected, abs=0.03)


def test_what_the_data_leave_of_parameters_takes_from_it(rng):
    """A size known to 4 in each: 3 apart is then nearly nothing; where it is off the fit, that counts."""
    look = [proposal("x", {"a": 0.0, "b": 3.0})]
    sure = ranked([member("a", 0.5), member("b", 0.5)], look, rng)[0].information_bits
    unsure = ranked([member("a", 0.5, 4.0), member("b", 0.5, 4.0)], look, rng)[0].information_bits
    met = ranked([member("a", 0.5, 0.0, 3.0), member("b", 0.5)], look, rng)[0].information_bits
    assert sure > 0.6
    assert unsure < 0.15
    assert met == pytest.approx(0.0, abs=1e-9)


def test_only_explanations_with_a_prediction_are_compared(rng):
    several = [member("a", 0.5), member("b", 0.3), member("c", 0.2)]
    (step,) = ranked(several, [proposal("x", {"a": 0.0, "b": 9.0}), proposal("alone", {"a": 0.0})], rng)
    assert step.name == "x"
    assert step.before == pytest.approx((0.5**2 + 0.3**2) / 0.8**2)
