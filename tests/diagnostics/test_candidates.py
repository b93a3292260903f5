"""Where the fits of candidates begin: at the point of the grid that says most."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.diagnostics.model.forward_model import Direction
from limbcli.diagnostics.model.linear import LinearFit
from limbcli.diagnostics.model.noise import ErrorDraws
from limbcli.diagnostics.selection.baseline_fit import BaselineFit
from limbcli.diagnostics.selection.candidates import Candidates, whitened_trials
from limbcli.diagnostics.selection.refits import Refits
from limbcli.diagnostics.statistical_tests.multiple_testing import score_family
from limbcli.diagnostics.statistical_tests.score import Trial
from limbcli.effects import effect
from limbcli.effects.reading import read
from limbcli.measurement.elastography import SweMap
from limbcli.progress import SILENT
from limbcli.stages.diagnosis.data.site_data import site_data
from limbcli.stages.diagnosis.data.windows import Windows
from limbcli.stages.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.stages.diagnosis.forward_model.surrogate import SiteCurves
from tests.diagnostics import reduced, toy

REGION = Windows(across=10, down=6, whole_is_known=True)


class Placed(toy.Toy):
    """`place` lies at some point of its grid."""

    def directions(self, fitted, name):
        found = super().directions(fitted, name)
        if name != "place":
            return found
        return [Direction(d.columns, d.signs, d.point, d.names, {"x": float(d.point[3:])}) for d in found]


def test_what_a_point_of_a_grid_begins_with_goes_with_its_trial(rng):
    data = Placed(toy.make(rng).y)
    baseline = BaselineFit(data, data.fit((), {}), 7, 200)
    trials = whitened_trials(data, baseline.base, {"place": None}, baseline.whiten, {}, SILENT)
    assert [each.at for each in trials[0].directions] == [{"x": 0.25}, {"x": 0.5}, {"x": 0.75}]


def look_alike(likeness: dict[frozenset[str], float], tests=()) -> Candidates:
    """Candidates a to d, of which these pairs look alike."""

    class Alike(Candidates):
        def _likeness(self, first, second):
            return likeness.get(frozenset((first, second)), 0.0)

    return Alike(None, dict.fromkeys("abcd"), SimpleNamespace(tests=tests))


def test_an_effect_is_exchanged_for_those_that_look_like_it_the_most_alike_first():
    alike = look_alike(
        {frozenset("ac"): 0.9, frozenset("bd"): 0.95, frozenset("bc"): 0.7, frozenset("ab"): 1.0}
    )
    both = SimpleNamespace(explanation=("a", "b"))
    assert alike.exchanged([both]) == [("a", "d"), ("c", "b")]
    again = alike.exchanged([both, SimpleNamespace(explanation=("c", "d"))])
    assert sorted(again) == [("a", "d"), ("c", "b")]  # each pair once


@pytest.mark.parametrize(("left_p", "longer"), [(0.01, [("x", "a"), ("x", "b")]), (0.05, [])])
def test_what_leaves_something_is_extended_by_what_is_near_significance(left_p, longer):
    """Not by a part of the data, which is no effect, nor by what shows nothing."""
    tests = [
        SimpleNamespace(name=name, p_adjusted=p, score=SimpleNamespace(statistic=statistic))
        for name, p, statistic in
        (("where: force", 0.001, 30.0), ("b", 0.15, 9.0), ("a", 0.15, 10.0), ("c", 0.3, 5.0))
    ]  # fmt: skip
    refit = SimpleNamespace(explanation=("x",), left_p=left_p, family=SimpleNamespace(tests=tests))
    assert look_alike({}).extended(refit, below=0.05) == longer


@pytest.mark.parametrize(
    ("gained", "further"),
    [(1.0, [("x", "b"), ("x", "c")]), (6.0, []), (None, [("x", "a"), ("x", "b"), ("x", "c")])],
)
def test_where_a_score_is_not_borne_out_those_that_score_next_are_tried(gained, further):
    """Half of what it promises is enough; a score that is not worth a parameter is not tried."""
    tests = [
        SimpleNamespace(name=name, p_adjusted=0.9, score=SimpleNamespace(statistic=statistic))
        for name, statistic in (("where: force", 30.0), ("a", 11.0), ("d", 1.9), ("c", 5.0), ("b", 8.0))
    ]

    def refitted(chi2: float, *explanation: str) -> SimpleNamespace:
        family = SimpleNamespace(tests=tests)
        return SimpleNamespace(explanation=explanation, family=family, state=SimpleNamespace(chi2=chi2))

    known = {each.explanation: each for each in (refitted(100.0, "x"), refitted(50.0, "a", "b"))}
    if gained is not None:
        known["a", "x"] = refitted(100.0 - gained, "a", "x")
    assert look_alike({}).next_extensions(known["x",], known) == further


def test_what_an_extension_beats_is_extended_by_all_that_may_fit_as_well():
    """The best extension gains 8, and 6 may be due to chance: a rival has to gain more than 2."""
    tests = [
        SimpleNamespace(name=name, p_adjusted=0.9, score=SimpleNamespace(statistic=statistic))
        for name, statistic in (("where: force", 30.0), ("a", 2.1), ("b", 1.9), ("c", 8.0))
    ]
    refit = SimpleNamespace(
        explanation=("x",), gap_beyond_chance=8.0 - 6.0, family=SimpleNamespace(tests=tests)
    )
    assert look_alike({}).rival_extensions(refit) == [("x", "c"), ("x", "a")]


def test_two_effects_look_as_alike_as_what_the_fit_leaves_of_them(rng):
    """What both share with the fitted parameters does not make them alike; nor does their size or sign."""
    jacobian = np.eye(6)[:, :1]
    columns = {"a": np.array([5.0, 3.0, 4.0, 0, 0, 0]), "b": -7 * np.array([9.0, 3.0, -4.0, 0, 0, 0])}
    state = LinearFit.of(rng.standard_normal(6), jacobian)
    trials = {name: Trial(name, (Direction(each[:, None], (0,)),)) for name, each in columns.items()}
    family = score_family(state, list(trials.values()), ErrorDraws((3,), 6, 200))
    assert Candidates(state, trials, family)._likeness("a", "b") == pytest.approx(7 / 25)


def with_a_ball(rng, x: float, depth: float) -> SiteForwardModel:
    """Maps of a reduced model with a stiff ball of 5 mm, another block than the one that is fitted."""
    theta = {"inclusion_x_mm": x, "inclusion_depth_mm": depth, "inclusion_radius_mm": 5.0}
    ball = ((effect("inclusion"), {"log_inclusion_ratio": 1.2, **theta}),)
    true = reduced.ReducedBook(
        reduced.block_model(9, 6, 7), np.linspace(0, 8, 7), spread=1.03, windows=REGION
    )
    levels = reduced.measured(rng, ball, simulations=true, n_levels=5)
    curves, reading, protocol = reduced.truth(ball, None, simulations=true, n_levels=5)
    lateral, below = (each.ravel() for each in np.meshgrid(np.arange(-19.5, 20.0), np.arange(2.5, 25.0)))
    parts = np.exp(read(curves, protocol, reading).log_speed[:, 1:])[:, REGION.part_of(lateral, below)]
    noise = 1 + 0.03 * rng.standard_normal((5, 1)) + 0.1 * rng.standard_normal(parts.shape)
    maps = [SweMap(lateral, below, each) for each in parts * noise]
    simulations = reduced.ReducedBook(reduced.block_model(8, 5, 6), np.linspace(0, 8, 6), windows=REGION)
    site = site_data("p1", levels, reduced.NOISE, windows=REGION, maps=maps)
    return SiteForwardModel([SiteCurves(site, simulations, {"inclusion": effect("inclusion")})])


@pytest.mark.slow
@pytest.mark.parametrize(("x", "depth"), [(-14.0, 19.0)])
def test_a_ball_beside_the_middle_is_found_where_it_is(rng, x, depth):
    """From the middle of the window least squares end in a large soft ball on the other side."""
    forward_model, not_evaluated = with_a_ball(rng, x, depth), {}
    facts = {each.name: each for each in forward_model.candidates}
    baseline = BaselineFit(forward_model, forward_model.fit((), {}), 7, 200)
    (trial,) = whitened_trials(forward_model, baseline.base, facts, baseline.whiten, not_evaluated, SILENT)
    refits = Refits(baseline, {"inclusion": trial}, facts, not_evaluated, {})
    found = refits.of(("inclusion",))
    assert found is not None
    assert found.state.chi2 < 0.2 * baseline.state.chi2
    values = found.fitted.values
    assert (values["inclusion_x_mm"], values["inclusion_depth_mm"]) == pytest.approx((x, depth), abs=2.0)
    assert values["log_inclusion_ratio"] == pytest.approx(1.2, abs=0.4)  # of so small a ball, with its edge
