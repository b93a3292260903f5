"""Which explanations are compared, and how far a rival may be behind."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.engine import diagnose
from limbcli.diagnostics.model.forward_model import Direction, Fitted
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.model.noise import unit_errors
from limbcli.diagnostics.selection import candidates
from limbcli.diagnostics.selection.confidence_set import Refit, compare
from limbcli.diagnostics.statistical_tests.multiple_testing import Family, Overall
from limbcli.diagnostics.statistical_tests.score import Trial
from tests.diagnostics import toy


def test_rivals_are_compared_round_their_own_fits(rng):
    """Two strong effects whose first-order forms have nothing in common, but whose fits have.

    With unit axes 0 .. n: one has 30 e0 and moves along e0, the other 30 e0 + e2 and moves along e1. Its
    gap is e1^2 - e0^2 + 2 e2 - 1 of the errors' own components.
    """
    n = 12
    axes = np.eye(n)

    def refit(name: str, prediction: np.ndarray, moves: np.ndarray) -> Refit:
        fitted = Fitted((name,), prediction, moves[:, None], (), {name: 1.0}, (name,), ())
        return Refit(fitted, LinearFit.of(np.zeros(n), moves[:, None]), Family((), None, 0.05))

    base = Fitted((), np.zeros(n), np.zeros((n, 0)), (), {}, (), ())
    one, other = refit("one", 30 * axes[0], axes[0]), refit("other", 30 * axes[0] + axes[2], axes[1])
    far = {("other",): Trial("other", (Direction(axes[5][:, None], (0,), "", ("other",)),))}
    compared = compare(
        [one, other], base, LinearFit.of(np.zeros(n), np.zeros((n, 0))), far, Whitener(np.eye(n)),
        lambda fitted: np.zeros((n, n)), rng=rng, relative=False,
    )  # fmt: skip
    e = unit_errors(rng, (100_000, n))
    gaps = np.maximum(e[:, 1] ** 2 - e[:, 0] ** 2 + 2 * e[:, 2] - 1, 0.0)
    assert compared[0].gap_allowed == pytest.approx(np.quantile(gaps, 1 - thresholds.BEATEN), rel=0.15)


@pytest.mark.parametrize(
    ("name", "of_adequate", "chi2", "gap", "estimates"),
    [
        ("barely not adequate, as good a fit", 0.9, 44.6, 3.1, True),
        ("worse by more than chance", 0.9, 46.0, 4.5, False),
        ("beaten", 0.9, 44.6, 9.6, False),
        ("far from adequate", 0.2, 44.6, 3.1, False),
        ("adequate, so a member by its own right", 1.1, 44.6, 3.1, False),
    ],
)
def test_a_level_barely_missed_does_not_take_an_equal_out_of_the_set(name, of_adequate, chi2, gap, estimates):
    def refit(share: float, chi2: float, gap: float) -> Refit:
        p = share * thresholds.ADEQUATE
        fitted = Fitted((name,), np.zeros(1), np.zeros((1, 0)), (), {}, (), ())
        state = LinearFit.of(np.array([np.sqrt(chi2)]), np.zeros((1, 0)))
        return Refit(fitted, state, Family((), Overall(chi2, 25, p, p), 0.05), gap, 9.0)

    assert refit(of_adequate, chi2, gap).is_close_to([refit(1.3, 41.5, 0.0)]) is estimates


def test_look_alikes_of_a_pair_are_tried_though_their_rank_was_low(rng, monkeypatch):
    monkeypatch.setattr(candidates, "best_pairs", lambda state, trials: [("offset", "toe")])
    found = diagnose(toy.make(rng, {"offset": 9.0, "toe": 14.0}), seed=7, n_draws=1500, propose=False)
    sets = {frozenset(each) for each in found.confidence_set}
    assert {frozenset(("offset", "toe")), frozenset(("offset", "twin-of-toe"))} <= sets


def test_no_effects_are_fitted_together_twice(rng):
    """Whatever the order that they come in."""
    case, requested = toy.make(rng, {"offset": 9.0, "wave": 8.0}), []
    fit = case.fit
    case.fit = lambda explanation, start: requested.append(frozenset(explanation)) or fit(explanation, start)
    found = diagnose(case, seed=7, n_draws=1500, propose=False)
    assert ("offset", "wave") in found.confidence_set
    assert max(Counter(each for each in requested if len(each) > 1).values()) == 1
