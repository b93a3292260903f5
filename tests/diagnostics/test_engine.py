"""The whole procedure on the linear toy: false alarms, right names, honest doubt."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.conclusions.account import Account
from limbcli.diagnostics.conclusions.next_measurement import (
    NextStep,
    best_step,
    rank_proposals,
    separation,
    useful_steps,
)
from limbcli.diagnostics.conclusions.sentences import sentences
from limbcli.diagnostics.engine import _Run, diagnose
from limbcli.diagnostics.model.estimates import Reported
from limbcli.diagnostics.model.forward_model import Fitted, Proposal
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.selection import baseline_fit
from limbcli.diagnostics.selection.baseline_fit import BaselineFit
from limbcli.diagnostics.selection.candidates import Candidates, closes_gross
from tests.diagnostics import toy


def run(case, seed: int = 7, **more):
    return diagnose(case, seed=seed, n_draws=1500, propose=False, **more)


@pytest.mark.slow
def test_nothing_missing_is_seldom_named(rng):
    """Two of 40 at the most, as of a test at 5 %. False alarms in 10 % of all data sets would pass with 22 %,
    in 20 % with 1 %."""
    verdicts = Counter(run(toy.make(rng), seed=k).verdict for k in range(40))
    assert verdicts["named"] + verdicts["ambiguous"] + verdicts["unexplained"] <= 2


@pytest.mark.parametrize(
    ("name", "size"), [("offset", 5.0), ("wave", 6.0), ("place", 12.0), ("guided", 30.0)]
)
def test_a_clear_effect_is_named_and_sized(rng, name, size):
    found = run(toy.make(rng, {name: size}))
    assert found.verdict == "named"
    assert found.chosen == (name,)
    assert abs(found.final.values[name] - size) < 0.3 * size
    assert found.shrink[-1].chi2_per_nu < 2.0 < found.shrink[0].chi2_per_nu
    low, high = found.refitted_sizes[name].intervals[name]
    assert low < found.final.values[name] < high
    before, after = (stage.held_out["all"] for stage in found.shrink)
    text = f"held-out error {before:.2f} to {after:.2f} deviations"
    assert any(text in each for each in sentences(found)), "a sentence says what the table of the page says"


def test_twins_are_never_told_apart(rng):
    found = run(toy.make(rng, {"toe": 12.0}))
    assert found.verdict == "ambiguous"
    assert {("toe",), ("twin-of-toe",)} <= set(found.confidence_set)
    assert found.angles["toe / twin-of-toe"] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("readings", [frozenset({"wave", "step"}), frozenset({"wave"})])
def test_what_needs_no_simulation_is_judged_whatever_else_was_simulated(rng, monkeypatch, readings):
    """Two effects of the readings alone cost nothing; only what has to be simulated is left out for time."""
    monkeypatch.setattr("limbcli.diagnostics.thresholds.MOST_SIMULATED", 0)
    found = run(toy.make(rng, {"wave": 7.0, "step": 7.0}, readings=readings))
    free = "step" in readings
    assert (("step", "wave") in {each.explanation for each in found.refits}) is free
    assert found.left_out.get("step + wave", "").startswith("not simulated") is not free


def test_c_and_m_of_several_that_fit_are_those_of_any(rng, monkeypatch):
    ends = {("toe",): (2.0, 3.0), ("twin-of-toe",): (2.5, 4.0)}

    def reported(self, fitted, *, scale=1.0, besides=None):
        low, high = ends.get(fitted.explanation, (1.0, 9.0))
        return Reported({"m": 2.7}, {"m": 2.7}, {"m": (low, high), "toe": (0.0, 1.0)})

    monkeypatch.setattr(toy.Toy, "reported", reported)
    found = run(toy.make(rng, {"toe": 12.0}))
    assert set(found.confidence_set) == set(ends)
    first, last = (stage.estimates for stage in found.shrink)
    assert (first.intervals["m"], first.over) == ((1.0, 9.0), 1)
    assert (last.intervals["m"], last.over) == ((2.0, 4.0), 2)
    assert last.intervals["toe"] == (0.0, 1.0)  # a size is its own explanation's


@pytest.mark.slow
@pytest.mark.parametrize("pair", [{"offset": 6.0, "wave": 6.0}, {"offset": 14.0, "guided": 60.0}])
def test_two_effects_are_found_together(rng, pair):
    """The pair is named, in two data sets of two, with nothing mocked. A share of 70 % would pass all
    four with 24 %, of 50 % with 6 %."""
    for _ in range(2):
        found = run(toy.make(rng, pair))
        assert found.verdict == "named"
        assert set(found.chosen) == set(pair)
        assert [each.explanation for each in found.shrink] == [found.chosen[:k] for k in range(3)]
        assert np.all(np.diff([each.chi2 for each in found.shrink]) < 0)


def test_an_effect_that_would_have_to_be_implausibly_large_is_no_explanation(rng):
    """The readings hold an offset of a hundred deviations of the prior; the fit stops far short of it."""
    case = toy.make(rng, {"offset": 30.0})
    assert run(case).chosen == ("offset",)
    case.roomy = 0.3
    found = run(case)
    assert ("offset",) not in found.confidence_set
    assert found.verdict != "adequate"


def test_a_prior_that_hardly_holds_changes_nothing(rng):
    case = toy.make(rng, {"wave": 6.0})
    free = run(case)
    case.roomy = 12.0
    held = run(case)
    assert held.chosen == free.chosen == ("wave",)
    assert held.shrink[-1].chi2_per_nu == pytest.approx(free.shrink[-1].chi2_per_nu, rel=0.02)


@pytest.mark.slow
def test_an_effect_outside_the_library_is_not_named(rng):
    found = run(toy.make(rng, outside=6.0))
    assert found.verdict in ("unexplained", "untestable")
    assert found.chosen == ()


def test_a_masked_effect_is_a_blind_spot(rng):
    found = run(toy.make(rng, {"masked": 2.0}))
    spot = next(each for each in found.blind_spots if each.name == "masked")
    assert found.verdict == "adequate"
    assert spot.visible_fraction < 0.1
    assert spot.is_undetectable
    assert spot.matters


def test_what_is_left_of_a_channel_is_its_root_mean_square(rng):
    """One datum that is ten deviations off among 13 makes 10/sqrt(13) of them, not 0."""
    case = toy.make(rng)
    off = 10.0 * (np.arange(len(case.y)) == 4)
    fitted = Fitted((), case.y - off, toy.BASE, ("c", "m", "k"), {})
    baseline = SimpleNamespace(
        data=case.data, forward_model=case, form_error=lambda fitted: None, is_relative=lambda state: False
    )
    left = Account(baseline)._stage(fitted, LinearFit.of(off, toy.BASE), None).rms
    assert left == pytest.approx({"force": 10.0 / np.sqrt(toy.N_FORCE), "speed": 0.0})


def test_assumed_noise_gets_no_absolute_test(rng):
    found = run(toy.make(rng, source="assumed"))
    assert found.relative
    assert found.verdict == "untestable"
    assert found.family.overall is None


def test_assumed_noise_still_shows_a_strong_shape(rng):
    found = run(toy.make(rng, {"offset": 14.0}, source="assumed", stated=3.0))
    assert ("offset",) in found.confidence_set


def test_understated_noise_is_recognised_by_its_scatter(rng):
    found = run(toy.make(rng, sd=3.0))
    assert found.roughness.ratio > 3.0
    assert found.relative
    assert found.verdict != "named"


def test_a_failed_refit_is_not_evaluated(rng):
    found = run(toy.make(rng, {"offset": 6.0}, failing="offset"))
    assert "offset" in found.not_evaluated
    assert found.verdict != "named"


def test_the_same_seed_gives_the_same_answer(rng):
    case = toy.make(rng, {"offset": 5.0})
    first, second = run(case, seed=3), run(case, seed=3)
    assert [t.p_adjusted for t in first.family.tests] == [t.p_adjusted for t in second.family.tests]
    assert sentences(first) == sentences(second)


def test_the_proposal_that_sees_the_difference_is_recommended(rng):
    found = diagnose(toy.make(rng, {"toe": 12.0}), n_draws=1500)
    assert found.next_steps[0].name == "look at the toe"
    assert found.next_steps[0].power > 0.8
    assert found.next_steps[0].power > found.next_steps[-1].power
    assert any("Next measurement: sees toe" in line for line in sentences(found))


@pytest.mark.parametrize(("added", "power"), [(0.0, 0.05), (1.645, 0.5), (4.0, 0.99)])
def test_the_power_of_a_proposal_is_its_own(added, power):
    """Fits that are 3 deviations apart in the data at hand, which did not tell them apart."""
    fits = [
        Fitted((name,), np.array([far, 0.0]), np.array([[0.0], [1.0]]), ("c",), {}) for name, far in
        (("a", 0.0), ("b", 3.0))
    ]  # fmt: skip
    seen = {("a",): np.zeros(1), ("b",): np.array([added])}
    proposal = Proposal("x", "look at x", seen, {each: np.zeros((1, 1)) for each in seen}, np.eye(1))
    steps = rank_proposals(fits, [proposal], Whitener.of(np.eye(2)))
    assert steps[0].distance_before == pytest.approx(3.0)
    assert steps[0].power == pytest.approx(power, abs=0.003)
    assert [each.name for each in useful_steps(steps)] == ["x"] * (added > 1.6)


def test_two_explanations_are_as_far_apart_as_the_better_of_them_follows_the_other():
    """The second has a parameter by which it does just what the first does; the first cannot follow it."""
    stiff = Fitted(("a",), np.array([1.0, 0.0]), np.array([[1.0], [0.0]]), ("c",), {})
    free = Fitted(("b",), np.array([1.0, 4.0]), np.eye(2), ("c", "m"), {})
    other = Fitted(("d",), np.array([9.0, 3.0]), np.array([[1.0], [0.0]]), ("c",), {})
    whiten = Whitener.of(0.25 * np.eye(2))
    assert separation(stiff, free, whiten) == separation(free, stiff, whiten) == pytest.approx(0.0)
    assert separation(stiff, other, whiten) == separation(other, stiff, whiten) == pytest.approx(6.0)


def test_a_pair_that_nothing_tells_apart_does_not_choose_the_measurement():
    def step(name, pair, power):
        return NextStep(name, name, ("a", pair), 1.0, 1.0, power)

    steps = [
        step("weight", "b", 0.92),
        step("weight", "c", 0.05),
        step("tare", "b", 0.11),
        step("tare", "c", 0.06),
    ]
    assert best_step(steps) == ("weight", 0.05)
    assert [each.power for each in useful_steps(steps)] == [0.92]
    assert best_step([]) is None


@pytest.mark.slow
def test_rates_over_many_data_sets(rng):
    """At twice the visible size: of 70 data sets 53 are named and right, two at the most are named wrong, and
    the truth is missing in three sets at the most.

    A share of right names of 65 % would pass with 4 %; 10 % of wrong names with 5 %; 10 % of truths that are
    missing with 7 %. They stood at 55, 0 and 0 when this was written.
    """
    sizes = {"offset": 3.4, "wave": 4.2, "place": 7.2, "guided": 23.0, "bias": 18.0, "step": 7.0, "jump": 7.2}
    right = wrong = inside = 0
    for k in range(70):
        name = list(sizes)[k % len(sizes)]
        found = run(toy.make(rng, {name: sizes[name]}), seed=k)
        if found.verdict == "named":
            right, wrong = right + (found.chosen == (name,)), wrong + (found.chosen != (name,))
        inside += (name,) in found.confidence_set
    assert right >= 53
    assert wrong <= 2
    assert inside >= 67


def test_no_name_where_something_is_left(rng, monkeypatch):
    """The one explanation that fits leaves something at the level of detection: perhaps it is not all."""
    case = toy.make(rng, {"wave": 6.0})
    assert run(case).verdict == "named"
    monkeypatch.setattr("limbcli.diagnostics.thresholds.LEFT", 1.01)
    found = run(case)
    assert found.verdict == "ambiguous"
    assert found.confidence_set == (("wave",),)
    assert "a residual remains" in found.reason
    assert sentences(found)[0].startswith("AMBIGUOUS: one explanation fits, but")
    assert not any(line.startswith("Next measurement") for line in sentences(found))


@pytest.mark.parametrize(("chi2", "refitted"), [(39.0, ["near"]), (41.0, ["near", "far"])])
def test_all_are_refitted_where_the_fit_without_effects_is_grossly_wrong(chi2, refitted):
    # From here on single rules of decision, with what surrounds them made up; whole diagnoses are above.
    """It may have ended anywhere; sensitivities there tell little."""
    tests = [
        SimpleNamespace(name=name, p_adjusted=p, score=SimpleNamespace(statistic=1 - p, direction=None))
        for name, p in (("far", 0.9), ("near", 0.01))
    ]
    family = SimpleNamespace(tests=tests, of=lambda name: next(t for t in tests if t.name == name))

    class Unlike(Candidates):
        def _likeness(self, first, second):
            return 0.0

    found = Unlike(SimpleNamespace(nu=10, chi2=chi2), {"far": None, "near": None}, family)
    assert found.promising({}) == refitted


@pytest.mark.parametrize(
    ("p_of_c", "refitted"), [(0.25, ["c", "b", "d"]), (0.06, ["c", "b", "d"]), (0.04, ["c"])]
)
def test_the_nearest_candidates_are_refitted_where_only_a_part_of_the_data_shows_something(p_of_c, refitted):
    """First order tells little of a strong effect: none is significant, and one of them it may be."""
    names, p = ("a", "force", "b", "c", "d"), (0.9, 0.001, 0.3, p_of_c, 0.5)
    tests = [
        SimpleNamespace(name=name, p_adjusted=each, score=SimpleNamespace(statistic=1 - each))
        for name, each in zip(names, p, strict=True)
    ]
    family = SimpleNamespace(tests=tests, of=lambda name: next(t for t in tests if t.name == name))

    class Unlike(Candidates):
        def _likeness(self, first, second):
            return 0.0

    found = Unlike(SimpleNamespace(nu=10, chi2=20.0), dict.fromkeys("abcd"), family)
    assert found.promising({}) == refitted


@pytest.mark.parametrize(
    ("before", "after", "closed"), [(888.0, 60.0, True), (500.0, 420.0, False), (390.0, 10.0, False)]
)
def test_noise_stated_too_small_is_no_evidence_for_an_effect(before, after, closed):
    """A gross misfit that stays is the noise's; one that an effect takes away speaks for it."""
    base, left = (SimpleNamespace(nu=100, chi2=chi2) for chi2 in (before, after))
    assert closes_gross(base, left) == closed


def judged(p_adjusted, statistic, n_parameters=1, p_among=None):
    direction = SimpleNamespace(names=("size",) * n_parameters)
    return SimpleNamespace(
        p_adjusted=p_adjusted,
        p_among=p_adjusted if p_among is None else p_among,
        score=SimpleNamespace(statistic=statistic, direction=direction),
    )


@pytest.mark.parametrize(
    ("before", "after", "gap", "speaks", "needed"),
    [(100.0, 8.0, 5.0, True, True), (100.0, 30.0, 5.0, True, False), (30.0, 5.0, 5.0, True, False),
     (100.0, 80.0, 5.0, False, False), (30.0, 20.0, 5.0, False, False), (30.0, 20.0, 3.0, False, True),
     (30.0, 20.0, None, False, False)],
)  # fmt: skip
def test_a_refit_that_gains_much_needs_no_score_of_its_own(before, after, gap, speaks, needed):
    """Its score was not significant at the fit without effects, where sensitivities may tell little; nor does
    one that fits as well as the best."""
    baseline = SimpleNamespace(state=SimpleNamespace(nu=10, chi2=before), relative=False)
    run = _Run(baseline, 3, False)
    run.family = SimpleNamespace(of=lambda name: judged(0.5, 0.0))
    run.refits = SimpleNamespace(trials={"all": SimpleNamespace(directions=[None] * 40)})
    fitted = SimpleNamespace(effect_names=("size",))
    state = SimpleNamespace(nu=9, chi2=after)
    refit = SimpleNamespace(explanation=("wave",), state=state, gap=gap, fitted=fitted)
    assert run._speaks_for_itself(refit) is speaks
    assert run._each_is_needed(refit, None) is needed


@pytest.mark.parametrize("adequate", [True, False])
def test_what_barely_is_not_adequate_is_told_beside_a_member_only(adequate):
    run = _Run(SimpleNamespace(state=None), 1, False)
    run.family = SimpleNamespace(of=lambda name: SimpleNamespace(p_adjusted=0.01))
    member = SimpleNamespace(explanation=("skin",), in_set=adequate, is_close_to=lambda kept: False)
    barely = SimpleNamespace(explanation=("wave",), in_set=False, is_close_to=lambda kept: member in kept)
    refits = SimpleNamespace(compared=lambda several: [member, barely], known={})
    candidates = SimpleNamespace(of_size=lambda *facts: [])
    kept = run._explanations(candidates, [], refits, refits.compared([]))
    assert kept == ([member, barely] if adequate else [])


@pytest.mark.parametrize(
    ("several", "objection", "word", "reason"),
    [([("a",), ("a", "b")], None, "named", "every explanation that fits includes a; "),
     ([("a",), ("a", "b")], ("ambiguous", "why"), "ambiguous", "every explanation that fits includes a, but "
         "why"),
     ([("a",), ("b",)], None, "ambiguous", "2 explanations fit"),
     ([("a",), ("b",)], ("ambiguous", "why"), "ambiguous", "2 explanations fit"),
     ([("a",), ("b", "c")], None, "ambiguous", "2 explanations fit"),
     ([("a",)], None, "named", "one explanation fits, and no other "),
     ([("a", "b"), ("a", "c")], None, "ambiguous", "2 explanations fit"),
     ([("a",)], ("unexplained", "why"), "unexplained", "one explanation fits, but why")],
)  # fmt: skip
def test_what_every_explanation_has_is_named_and_the_others_are_kept(several, objection, word, reason):
    run = _Run(SimpleNamespace(), 3, False)
    run._why_not_named = lambda best, kept, promising: objection
    run._finish = lambda verdict, why, best, kept=(): (verdict, why, [each.explanation for each in kept])
    kept = [
        SimpleNamespace(explanation=each, is_adequate=True, state=SimpleNamespace(chi2=10.0 - len(each)))
        for each in several
    ]
    verdict, why, explanations = run._conclude(kept, [])
    assert (verdict, explanations) == (word, several)
    assert why.startswith(reason)


@pytest.mark.parametrize(("word", "over"), [("named", 2), ("ambiguous", 2), ("unexplained", 0)])
def test_c_and_m_reach_over_all_that_fit_also_beside_a_name(monkeypatch, word, over):
    class Seen(Exception):
        pass

    def shrink(self, refit, refits, alike=()):
        raise Seen(len(alike))

    monkeypatch.setattr("limbcli.diagnostics.engine.Account.shrink", shrink)
    run = _Run(SimpleNamespace(), 3, False)
    kept = (SimpleNamespace(explanation=("a",)), SimpleNamespace(explanation=("a", "b")))
    with pytest.raises(Seen) as seen:
        run._finish(word, "why", kept[0], kept)
    assert seen.value.args == (over,)


@pytest.mark.parametrize(
    ("alone", "with_one_more", "named"),
    [(0.2, None, True), (0.02, None, False), (0.02, 0.3, False), (0.02, 0.03, False), (0.2, 0.3, True)],
)
def test_a_name_leaves_nothing_that_would_be_detected(monkeypatch, alone, with_one_more, named):
    """Where one effect more explains what it leaves, it may be half of a pair."""
    run = _Run(SimpleNamespace(), 3, False)
    run._chance_of = lambda refit, **how: 0.0
    monkeypatch.setattr("limbcli.diagnostics.engine.Closing.is_closed", lambda self, refit: True)
    fitted = SimpleNamespace(notes=(), at_bound=())
    kept = [SimpleNamespace(explanation=("a",), left_p=alone, fitted=fitted, is_beaten=False)]
    if with_one_more is not None:
        kept.append(SimpleNamespace(explanation=("a", "b"), left_p=with_one_more, fitted=fitted))
    objection = run._why_not_named(kept[0], kept, [])
    assert (objection is None) == named
    assert named or objection[0] == "ambiguous"


@pytest.mark.parametrize("beaten", [False, True])
def test_no_name_for_what_a_larger_explanation_beats(monkeypatch, beaten):
    run = _Run(SimpleNamespace(), 3, False)
    run._chance_of = lambda refit, **how: 0.0
    monkeypatch.setattr("limbcli.diagnostics.engine.Closing.is_closed", lambda self, refit: True)
    fitted = SimpleNamespace(notes=(), at_bound=())
    kept = [
        SimpleNamespace(
            explanation=each, left_p=0.5, fitted=fitted, is_beaten=beaten and len(each) == 1,
            state=SimpleNamespace(chi2=10.0 - len(each)),
        )
        for each in [("a",), ("a", "b")]
    ]  # fmt: skip
    objection = run._why_not_named(kept[0], kept, [])
    assert objection == (("ambiguous", "a + b fits better than chance allows") if beaten else None)


@pytest.fixture(
    scope="module", params=[(188, {"jump": 14.0, "wave": 2.8}), (190, {"offset": 7.0, "wave": 2.6})]
)
def two_hidden(request):
    """Two hidden effects, the second weak, and the diagnosis."""
    seed, sizes = request.param
    return list(sizes), run(toy.make(np.random.default_rng(seed), sizes), seed=seed)


@pytest.mark.slow
def test_where_another_second_effect_beats_the_first_alone_the_true_one_is_found_as_well(two_hidden):
    """The residual of the first suggests another than the true one, or also the true one. The first alone
    stays beaten, although more rivals allow a larger gap."""
    hidden, found = two_hidden
    assert found.verdict == "ambiguous"
    assert set(hidden) in [set(each) for each in found.confidence_set]
    assert len(set(map(frozenset, found.confidence_set))) == len(found.confidence_set) > 2
    assert next(each for each in found.refits if each.explanation == (hidden[0],)).is_beaten


@pytest.mark.slow
def test_an_effect_that_gains_next_to_nothing_beside_another_is_not_in_the_set(two_hidden):
    """Of the pairs with the first effect, which is adequate alone, some fit better by less than 2."""
    hidden, found = two_hidden
    refits = {frozenset(each.explanation): each for each in found.refits}
    first = frozenset(hidden[:1])
    gains = {pair: refits[first].state.chi2 - refits[pair].state.chi2 for pair in refits if first < pair}
    little = {pair for pair, gain in gains.items() if gain < 2.0}
    assert refits[first].is_adequate
    assert any(refits[pair].in_set for pair in little)
    assert not little & set(map(frozenset, found.confidence_set))
    assert frozenset(hidden) in set(map(frozenset, found.confidence_set)) - little


@pytest.mark.parametrize(
    ("p", "after", "several", "named"),
    [(0.043, 95.0, 1, False), (0.019, 95.0, 1, True), (0.043, 60.0, 1, True), (0.043, 95.0, 2, True)],
)
def test_no_name_for_what_one_site_in_twenty_with_nothing_missing_shows(
    monkeypatch, p, after, several, named
):
    """Its own evidence is that of chance, and its refit tells no more; two effects were each needed."""
    run = _Run(SimpleNamespace(state=SimpleNamespace(nu=100, chi2=100.0), relative=False), 3, False)
    run.family = SimpleNamespace(of=lambda name: judged(0.045, 5.0, p_among=p))
    run.refits = SimpleNamespace(trials={"all": SimpleNamespace(directions=[None] * 40)}, known={})
    monkeypatch.setattr("limbcli.diagnostics.engine.Closing.is_closed", lambda self, refit: True)
    best = SimpleNamespace(
        explanation=("a", "b")[:several], left_p=0.5, state=SimpleNamespace(nu=99, chi2=after),
        is_beaten=False, fitted=SimpleNamespace(notes=(), at_bound=(), effect_names=("size",)),
    )  # fmt: skip
    objection = run._why_not_named(best, [best], [])
    assert (objection is None) == named
    assert named or objection == ("ambiguous", "its own evidence is too weak to name it (p 0.043)")


@pytest.mark.parametrize(
    ("gained", "p"), [(15.2, 0.0088), (14.8, 0.0088), (20.0, 0.0088), (10.9, 0.057), (0.0, 1.0)]
)
def test_a_score_is_evidence_as_far_as_the_refit_bears_it_out(gained, p):
    """Two parameters: the tail of chi2 falls by e every 2; the first order promised 15.2."""
    run = _Run(SimpleNamespace(state=SimpleNamespace(nu=100, chi2=100.0), relative=False), 3, False)
    run.family = SimpleNamespace(of=lambda name: judged(0.0088, 15.2, n_parameters=2))
    run.refits = SimpleNamespace(trials={"all": SimpleNamespace(directions=[None] * 400)}, known={})
    refit = SimpleNamespace(
        explanation=("a",), state=SimpleNamespace(nu=98, chi2=100.0 - gained),
        fitted=SimpleNamespace(effect_names=("size", "shape")),
    )  # fmt: skip
    assert run._chance_of(refit, times=10.0) == pytest.approx(p, abs=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_what_no_refit_bears_out_is_not_found(seed):
    """Only the effect's own direction stands out, to first order; a size held near 0 gains too little."""
    found, held = (
        run(toy.make(np.random.default_rng(seed), {"guided": 12.0}, roomy=roomy)) for roomy in (None, 0.3)
    )
    assert found.verdict == "ambiguous"
    assert held.verdict == "adequate"
    assert "to first order (guided)" in held.reason
    assert not held.confidence_set
    assert [each.explanation for each in held.shrink] == [()]
    assert ("guided",) in {each.explanation for each in held.refits}


@pytest.mark.parametrize(
    ("overall", "others", "gained", "nothing"),
    [(0.5, [], 5.0, True), (0.5, [], 10.0, False), (0.01, [], 5.0, False), (0.5, ["where: maps"], 5.0, False),
     (0.5, ["not refitted"], 5.0, False)],
)  # fmt: skip
def test_all_that_is_significant_must_be_effects_that_gain_too_little(overall, others, gained, nothing):
    run = _Run(SimpleNamespace(state=SimpleNamespace(nu=100, chi2=100.0), relative=False), 3, False)
    names = ["a", *others, "far from it"]
    tests = [judged(p, 10.0) for p in [0.03] * (1 + len(others)) + [0.7]]
    for name, each in zip(names, tests, strict=True):
        each.name = name
    run.family = SimpleNamespace(overall=SimpleNamespace(p_adjusted=overall), tests=tests)
    single = SimpleNamespace(explanation=("a",), state=SimpleNamespace(chi2=100.0 - gained))
    assert run._is_borne_out_by_none([single]) is nothing


@pytest.mark.parametrize("source", ["assumed", "repeats"])
def test_a_next_measurement_is_weighed_beside_data_as_sure_as_they_scatter(rng, source):
    """Their noise was taken three times too small: they tell two explanations apart by as much less."""
    case = toy.make(rng, {"toe": 12.0}, source=source, stated=1 / 3)
    baseline = BaselineFit(case, case.fit((), {}), seed=7, n_draws=300)
    fits = [case.fit((name,), {}) for name in ("toe", "hump")]
    kept = [SimpleNamespace(fitted=each, state=baseline.linearised(each)) for each in fits]
    steps = Account(baseline).next_steps(kept, {})
    best = kept[0].state
    assert baseline.is_relative(best)
    expected = separation(*fits, baseline.whiten) / np.sqrt(best.chi2 / best.nu)
    assert best.chi2 > 4 * best.nu
    assert [each.distance_before for each in steps] == pytest.approx([expected] * 2)


def test_what_a_refit_bears_out_is_the_same_whatever_level_was_assumed_of_noise_of_unknown_level():
    """The refit leaves as much as its noise says, or, with deviations taken three times too small, nine times
    as much: of a promise of 10 it gains 8 either way."""
    found = []
    for times in (1.0, 9.0):
        baseline = SimpleNamespace(state=SimpleNamespace(nu=100, chi2=107.0 * times), relative=True)
        refit = SimpleNamespace(explanation=("a",), state=SimpleNamespace(nu=99, chi2=99.0 * times))
        found.append(_Run(baseline, 3, False)._borne_out(0.01, judged(0.01, 10.0 * times), refit))
    assert found[1] == pytest.approx(found[0])
    assert found[0] < 0.05


@pytest.mark.parametrize(("given", "named"), [(20.0, False), (19.0, False), (12.0, True)])
def test_no_name_where_the_tissue_would_stand_on_a_bound_with_it(rng, monkeypatch, given, named):
    """Unless the fit is so flat that its prior has m inside: then that is the value that is told."""
    fit = toy.Toy.fit

    def held(self, explanation, start):
        found = fit(self, explanation, start)
        return replace(found, notes=("m ended on its bound 20",)) if explanation else found

    def reported(self, fitted, *, scale=1.0, besides=None):
        return Reported({**fitted.values, "m": given}, {**fitted.values, "m": 20.0})

    monkeypatch.setattr(toy.Toy, "fit", held)
    monkeypatch.setattr(toy.Toy, "reported", reported)
    found = run(toy.make(rng, {"offset": 5.0}))
    assert (found.verdict, found.chosen) == ("named" if named else "ambiguous", ("offset",))
    assert ("m ended on its bound 20" in found.reason) != named


class Told(toy.Toy):
    """Notes the scale of deviances that intervals are asked for with."""

    def reported(self, fitted, *, scale=1.0, besides=None):
        self.__dict__.setdefault("scales", []).append(scale)
        return super().reported(fitted, scale=scale, besides=besides)


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_intervals_know_that_few_data_tell_the_level_of_the_noise(rng, times):
    """By F(1, nu): with 1.96 deviations, 5 data more than parameters would hold the truth in 89 %."""
    made = toy.make(rng, sd=times)
    reported = Told(made.y)
    found = diagnose(reported, n_draws=300, propose=False)
    assert found.relative is (times > 1.0)
    base = found.shrink[0]
    expected = base.chi2_per_nu * stats.f.ppf(0.95, 1, base.nu) / 3.84 if times > 1.0 else 1.0
    assert reported.scales[0] == pytest.approx(expected, rel=1e-3)


def test_draws_go_on_until_an_adjusted_p_is_clear_of_all_by_which_something_is_decided(rng, monkeypatch):
    """With 5000 draws a p of 0.022 is known to 0.01: four of them were as extreme, and a name hung on it."""
    decided, scored = [], baseline_fit.score_family

    def noted(*args, **options):
        decided.append(options["decisive"])
        return scored(*args, **options)

    monkeypatch.setattr(baseline_fit, "score_family", noted)
    diagnose(toy.make(rng, {}), n_draws=300, propose=False)
    assert {thresholds.ALPHA, thresholds.NAMED} <= set(decided[0])
