"""The explanations of the toy's data: all of them, with the probabilities of their evidence, however they
are found."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.forward_model import Explanation
from limbcli.diagnosis.explanations.laplace import posterior
from limbcli.diagnosis.explanations.search import Explained, PriorOdds, Search, containing, credible, named
from tests.diagnosis import toy

NAMES = list(toy.SIGNATURES)
PAIRS = list(itertools.combinations(NAMES, 2))


def search(case: toy.Toy, most: int = 2) -> Search:
    made = Search(case, case.fit((), {}), False, most)
    made.linearise(())
    return made


def several(*given: tuple[Explanation, float]) -> list[Explained]:
    return [Explained(explanation, p, 0.0, None) for explanation, p in given]


@pytest.mark.parametrize(("n", "most"), [(1, 2), (2, 2), (12, 2), (12, 1), (40, 2)])
@pytest.mark.parametrize("something", [0.2, 0.5, 0.7])
def test_prior_probabilities_of_all_explanations_are_one_together(n, most, something):
    odds = PriorOdds(n, something, most)
    names = [str(k) for k in range(n)]
    pairs = list(itertools.combinations(names, 2)) if most > 1 else []
    given = [odds.ln(each) for each in [(), *((name,) for name in names), *pairs]]
    assert np.exp(given).sum() == pytest.approx(1.0)
    assert np.exp(odds.ln_single) * n == pytest.approx(something / (1.0 - something))
    if pairs:
        of_one = odds.ln((names[0],)) - odds.ln(())
        of_two = odds.ln(pairs[0]) - odds.ln(())
        assert of_two == pytest.approx(2 * of_one + np.log(1.0 - something))


def test_what_every_likely_explanation_has_is_named():
    assert named(several((("a",), 0.6), (("a", "b"), 0.36), ((), 0.04))) == ("a",)
    assert named(several((("a",), 0.6), (("a", "b"), 0.34), ((), 0.06))) == ()
    assert named(several((("a", "b"), 0.96), (("a",), 0.04))) == ("a", "b")
    assert named(several(((), 0.97), (("a",), 0.03))) == ()
    assert named(several((("a", "b"), 0.5), (("a",), 0.46), ((), 0.04))) == ("a",)
    assert named(several((("a", "b"), 0.9), (("a", "c"), 0.06), (("a",), 0.04))) == ()  # two of them show


def test_the_credible_set_is_the_smallest_with_its_probability():
    given = several((("a",), 0.7), (("b",), 0.2), (("a", "b"), 0.06), ((), 0.04))
    assert [each.explanation for each in credible(given)] == [("a",), ("b",), ("a", "b")]
    assert [each.explanation for each in credible(several((("a",), 0.951), ((), 0.049)))] == [("a",)]


def exact(case: toy.Toy) -> dict[Explanation, float]:
    """By a fit of each explanation, none left out."""
    odds, explanations = PriorOdds(len(NAMES)), [(), *((name,) for name in NAMES), *PAIRS]
    fits = [posterior(case.fit(each, {}), case.y, case.data.noise) for each in explanations]
    ln = np.array([found.ln_evidence + odds.ln(each) for found, each in zip(fits, explanations, strict=True)])
    return dict(zip(explanations, np.exp(ln - np.logaddexp.reduce(ln)), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(
    "hidden", [{}, {"offset": 5.0}, {"offset": 6.0, "wave": 6.0}, {"toe": 9.0, "place": 9.0}]
)
def test_probabilities_are_those_of_fitting_everything(rng, hidden):
    """In a linear model estimates are exact but for the limits of sizes and the grid of the other effect:
    of 79 explanations, all that are likely are within 0.03 of what fits of all of them say."""
    case = toy.make(rng, hidden)
    found, expected = {each.explanation: each.probability for each in search(case).run()}, exact(case)
    assert found.keys() == expected.keys()
    assert sum(found.values()) == pytest.approx(1.0)
    assert max(abs(found[each] - expected[each]) for each in found) < 0.03


def test_a_pair_is_found_that_neither_of_its_effects_explains(rng):
    found = search(toy.make(rng, {"offset": 6.0, "wave": 6.0})).run()
    assert set(found[0].explanation) == {"offset", "wave"}
    assert found[0].probability > 0.5
    assert found[0].simulated
    assert found[0].posterior is not None


def test_with_one_effect_at_the_most_there_are_no_pairs(rng):
    found = search(toy.make(rng, {"offset": 6.0, "wave": 6.0}), most=1).run()
    assert {len(each.explanation) for each in found} == {0, 1}
    assert sum(each.probability for each in found) == pytest.approx(1.0)


def test_what_is_likely_rests_on_a_simulation_or_needs_none(rng):
    for readings in (frozenset(), frozenset(NAMES)):
        made = search(toy.make(rng, {"toe": 7.0}, readings=readings))
        for each in made.run():
            assert each.probability <= decisions.UNSETTLED or each.explanation in made.settled
            assert each.simulated is (each.explanation in made.simulated)
        assert bool(made.simulated) is not bool(readings)


def test_before_a_pair_its_effects_alone_are_simulated(rng):
    """Simulation can raise the evidence of any of them: a simulated pair would beat what is estimated."""
    case = toy.make(rng, {"toe": 7.0, "offset": 6.0}, readings=frozenset())
    made = search(case)
    order: list[Explanation] = []
    verified = case.verified
    case.verified = lambda fitted: (order.append(fitted.explanation), verified(fitted))[1]
    pairs = [each.explanation for each in made.run() if len(each.explanation) == 2 and each.simulated]
    assert {"toe", "offset"} in map(set, pairs)
    assert all(order.index((name,)) < order.index(pair) for pair in pairs for name in pair)


def told(failing: Sequence[Explained], name: str) -> dict[Explanation, float]:
    return {each.explanation: each.probability for each in failing if name in each.explanation}


def test_a_fit_that_fails_keeps_its_linear_estimate_and_is_reported(rng):
    """Left out, the others would share its probability: the most likely of them would be named in its
    place."""
    case = toy.make(rng, {"offset": 6.0})
    whole = told(search(case).run(), "offset")
    case.failing = "offset"
    made = search(case)
    found = made.run()
    assert made.not_evaluated["offset"] == "the toy does not converge"
    assert all(each.posterior is None for each in found if "offset" in each.explanation)
    assert told(found, "offset").keys() == whole.keys()
    assert told(found, "offset")["offset",] == pytest.approx(whole["offset",], abs=0.1)
    assert named(found) == ("offset",)


def test_a_fit_that_cannot_be_simulated_keeps_its_evidence_and_is_reported(rng):
    case = toy.make(rng, {"offset": 6.0}, unsimulated="offset")
    made = search(case)
    found = made.run()
    assert made.not_evaluated["offset"] == "the toy cannot be simulated"
    assert found[0].explanation == ("offset",)
    assert found[0].posterior is not None
    assert not found[0].simulated


def test_probability_of_an_effect_is_that_of_all_that_contain_it():
    given = several((("a",), 0.5), (("a", "b"), 0.3), (("b",), 0.15), ((), 0.05))
    assert containing(("a",), given) == pytest.approx(0.8)
    assert containing((), given) == pytest.approx(1.0)


def test_a_pair_is_estimated_about_the_fit_of_its_likely_effect(rng):
    """Exact there for one without a grid; the grid of another is averaged, as a fit does."""
    case = toy.make(rng, {"offset": 6.0})
    made = search(case)
    found = {each.explanation: each for each in made.run()}
    of_first, about = made.known[("offset",)].ln_evidence, made.linear[("offset",)]
    for other in ("wave", "hump", "place"):
        pair = ("offset", other)
        assert found[pair].posterior is None, "it is not likely"
        assert found[pair].ln_evidence == pytest.approx(of_first + float(about.ln_factor(other)[0]))
        if other != "place":
            exact = posterior(case.fit(pair, {}), case.y, case.data.noise).ln_evidence
            assert found[pair].ln_evidence == pytest.approx(exact, abs=1e-6)
