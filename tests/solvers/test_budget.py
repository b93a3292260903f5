"""Solves that are stopped by their work, at the same point on every machine."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

from limbcli.progress import Progress
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.session_options import Budget, BudgetSpent, StartFrom, StopWhen
from tests.fem.small_models import punch

AFRESH = StartFrom(independent=True)


@pytest.mark.parametrize(
    ("needed", "spent"), [(6 / 8, 2 * 30 * 40 + 30), (np.inf, 30 * 340)], ids=["some", "all alike"]
)
def test_load_steps_beyond_those_needed_take_as_much_work_again(needed, spent):
    """Six of eight are needed; the seventh goes on for ever."""
    budget = Budget(allowed=40_000, needed=needed)
    steps = [*(1 + k // 8 for k in range(1, 41)), *[7] * 300]
    with contextlib.suppress(BudgetSpent):
        for step in steps:
            budget.charge(step=step, n_steps=8, krylov=20, factorisations=0)
    assert budget.spent == spent


def test_a_solve_is_charged_for_all_its_operations_and_for_no_others():
    """As the solver reports them to its listeners: each iteration counts 10 products, each factor 20."""
    seen = []
    session = ReferenceSession(
        punch(levels=2), threads=1, progress=Progress(lambda kind, facts: seen.append((kind, facts)))
    )
    budgets = [Budget(), Budget()]
    counted = []
    for each in budgets:
        seen.clear()
        session.solve(keep_levels=False, start=AFRESH, stop=StopWhen(budget=each))
        newton = [facts for kind, facts in seen if kind == "newton"]
        last = newton[-1]
        counted.append(10 * len(newton) + last["krylov"] + 20 * last["factorisations"])
    session.close()
    assert [each.spent for each in budgets] == counted
    assert counted[0] == counted[1] > 0


def test_a_spent_budget_ends_a_solve_with_what_it_reached_if_that_is_enough():
    session = ReferenceSession(punch(levels=3), threads=1)
    whole = Budget()
    every = session.solve(keep_levels=False, start=AFRESH, stop=StopWhen(budget=whole)).must_points
    short = 0.9 * whole.spent
    with pytest.raises(BudgetSpent) as stopped:
        session.solve(keep_levels=False, start=AFRESH, stop=StopWhen(budget=Budget(allowed=short)))
    some = session.solve(
        keep_levels=False, start=AFRESH, stop=StopWhen(required=1, budget=Budget(allowed=short))
    ).must_points
    unlimited = session.solve(keep_levels=False, start=AFRESH).must_points
    session.close()
    assert stopped.value.facts["allowed"] == short
    assert 1 <= len(some.forces) < 3
    np.testing.assert_array_equal(some.forces, every.forces[: len(some.forces)])
    np.testing.assert_array_equal(unlimited.forces, every.forces)
