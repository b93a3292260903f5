"""Levels that need not be reached, guesses from another session, and what a session's solves count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import punch

from limbcli.errors import SolveError
from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.equilibrium.load_stepping import BRIEF_CUTS
from limbcli.fem.equilibrium.stagnation import Stagnation
from limbcli.fem.motion.state import Forces, State
from limbcli.materials import ogden_type
from limbcli.model import Array, LimbModel
from limbcli.model.bodies import Drive
from limbcli.solvers.session import ReferenceSession
from limbcli.solvers.session_options import StartFrom, StopWhen


def too_deep() -> LimbModel:
    """Levels at 1 mm and, which no solver reaches, beyond the bottom of the block."""
    model = punch(levels=2)
    down = Drive("probe", "z", "displacement", -1.0, "way")
    drives = tuple(down if each.dof == "z" else each for each in model.drives)
    way = replace(model.curves["ramp"], points=((0.0, 0.0), (0.5, 1.0), (1.0, 9.0)))
    return replace(model, drives=drives, curves={**model.curves, "way": way})


@pytest.mark.slow
def test_a_level_that_is_not_required_ends_the_run_and_one_that_is_fails_it():
    session = ReferenceSession(too_deep(), threads=1)
    reached = session.solve(stop=StopWhen(required=1)).must_points
    assert reached.depths == pytest.approx([1.05])
    with pytest.raises(SolveError, match="load step 2 of 2"):
        session.solve()
    assert session.solve(stop=StopWhen(required=1)).must_points.forces == pytest.approx(
        reached.forces, rel=1e-5
    )
    brief = session._analysis.counts.retries
    full = session.solve(stop=StopWhen(required=1, full_effort=2)).must_points.forces
    assert full == pytest.approx(reached.forces, rel=1e-5)
    assert session._analysis.counts.retries - brief > BRIEF_CUTS + 1  # with the full effort
    session.close()


def test_every_solve_of_a_session_counts_its_own_work():
    session = ReferenceSession(punch(), threads=1)
    first = session.solve().simulation
    other = session.model.with_material("tissue", ogden_type(c=0.005, f_kappa=5.0, m=6.0))
    second = session.solve(other).simulation
    assert second.n_iterations > first.n_iterations > 0
    assert session._analysis.newton.linearised.counts is session._analysis.newton.counts
    assert session._analysis.counts.krylov > 0 == session._analysis.newton.counts.krylov
    session.close()


def test_guesses_from_another_session_lead_to_the_same_force_with_less_work():
    base = punch(depth=2.0)
    harder = replace(base, contacts=tuple(replace(each, penalty=80.0) for each in base.contacts))
    first = ReferenceSession(base, threads=1)
    first.solve()
    alone, led = ReferenceSession(harder, threads=1), ReferenceSession(harder, threads=1)
    led.start_like(first)
    found, expected = led.solve(), alone.solve()
    np.testing.assert_allclose(found.must_points.forces, expected.must_points.forces, rtol=1e-4)
    work, alone_work = (r.simulation.n_iterations + r.simulation.n_factorisations for r in (found, expected))
    assert work < alone_work
    for each in (first, alone, led):
        each.close()


def test_a_session_that_starts_like_another_leaves_that_ones_guesses_alone():
    """Else what a solve takes, and whether it is given up, depends on what was tried before it."""
    base = punch(depth=2.0)
    session = ReferenceSession(base, threads=1)
    session.solve()
    harder = base.with_material("tissue", ogden_type(c=0.005, f_kappa=5.0, m=6.0))

    def work(*, keep_levels: bool) -> list[int]:
        """Iterations of a new session's solve and of the same once more."""
        other = ReferenceSession(base, threads=1)
        other.start_like(session)
        return [other.solve(harder, keep_levels=keep_levels).simulation.n_iterations for _ in range(2)]

    before = work(keep_levels=True)
    after = work(keep_levels=False)
    assert before[0] == after[0]
    assert before[1] < after[1]


def test_a_solve_may_be_led_by_levels_of_its_own():
    """The same answer in fewer iterations, and later solves know nothing of it."""
    base = punch(depth=2.0)
    near = base.with_material("tissue", ogden_type(c=0.005, f_kappa=5.0, m=5.8))
    requested = base.with_material("tissue", ogden_type(c=0.005, f_kappa=5.0, m=6.0))
    session = ReferenceSession(base, threads=1)
    first = session.solve()
    afresh = StartFrom(independent=True)
    alone, other = (session.solve(each, keep_levels=False, start=afresh) for each in (requested, near))
    led = session.solve(requested, keep_levels=False, start=replace(afresh, levels=other.levels))
    again = session.solve(requested, keep_levels=False, start=afresh)
    session.close()
    np.testing.assert_allclose(led.must_points.forces, alone.must_points.forces, rtol=1e-5)
    counts = np.diff([each.simulation.n_iterations for each in (first, alone, other, led, again)])
    assert counts[2] < counts[0] == counts[3]


def test_levels_after_the_last_that_is_asked_for_are_not_tried():
    session = ReferenceSession(punch(levels=3), threads=1)
    every = session.solve().must_points
    some = session.solve(stop=StopWhen(last=2)).must_points
    session.close()
    assert len(every.depths) == 3
    assert some.forces == pytest.approx(every.forces[:2], rel=1e-5)


def test_a_run_ends_with_the_first_level_that_bears_enough():
    session = ReferenceSession(punch(levels=3), threads=1)
    every = session.solve().must_points
    between = float(every.forces[:2].mean())
    some = session.solve(stop=StopWhen(enough_force=between)).must_points
    session.close()
    assert some.forces == pytest.approx(every.forces[:2], rel=1e-5)


@pytest.mark.slow
def test_what_iterations_no_longer_lessen_will_do_where_it_may_and_else_fails(monkeypatch):
    monkeypatch.setattr("limbcli.fem.equilibrium.newton._ROUND_OFF", 0.0)
    exact = ReferenceSession(punch(), threads=1, tolerance=1e-8)
    expected = exact.solve().must_points
    refused = ReferenceSession(punch(), threads=1, tolerance=1e-30)
    with pytest.raises(SolveError, match="target 1e-30"):
        refused.solve()
    allowed = ReferenceSession(punch(), threads=1, tolerance=1e-30, stalled=1e-6)
    found = allowed.solve().must_points
    for each in (exact, refused, allowed):
        each.close()
    assert found.forces == pytest.approx(expected.forces, rel=1e-5)


def test_residuals_that_come_in_turns_are_seen_and_falling_ones_are_not():
    def noted(*errors: float) -> Stagnation:
        stagnation = Stagnation(5e-3)
        for k, error in enumerate(errors):
            contact = ContactState(State(float(k), np.zeros((1, 3)), ()), (), 1)
            residual = np.array([error])
            stagnation.note(Forces(residual, residual, residual, 1.0, contact, 1.0, (0, 0), residual))
        return stagnation

    turns = noted(0.1, 2.7e-3, 1.95e-3, 2.71e-3, 1.951e-3)
    assert turns.repeats
    assert turns.least is not None
    assert turns.least.contact.state.time == 2.0
    assert not noted(0.1, 2.7e-3, 1.95e-3, 1.4e-3, 1.2e-3).repeats
    assert not noted(0.1, 0.27, 0.195, 0.27, 0.195).repeats  # too large to do, and yet it may end
    assert noted(0.1, *[0.27, 0.195] * 6).repeats, "twelve in turn lead nowhere"
    assert not noted(*[0.27 * 0.95**k for k in range(20)]).repeats


def test_a_solve_afresh_depends_on_nothing_but_the_levels_that_lead():
    base = punch(depth=2.0)
    laws = [base.with_material("tissue", ogden_type(c=0.005, f_kappa=f, m=m)) for f, m in ((5, 6), (40, 2))]

    def force(*before: LimbModel, independent: bool) -> Array:
        session = ReferenceSession(base, threads=1, tolerance=1e-3)
        for each in before:
            session.solve(each, keep_levels=False)
        found = session.solve(laws[0], start=StartFrom(independent=independent)).must_points.forces
        session.close()
        return found

    np.testing.assert_array_equal(force(laws[1], independent=True), force(independent=True))
    assert (force(laws[1], independent=False) != force(independent=False)).any()
