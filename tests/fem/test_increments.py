"""What becomes of an increment: each outcome where it belongs, and in whole solves."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from small_models import punch

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis, RunEnd
from limbcli.fem.equilibrium import relaxation
from limbcli.fem.equilibrium.increments import Increment, IncrementOutcome, LoadStepPath, Reached
from limbcli.fem.equilibrium.load_stepping import LoadStepping
from limbcli.fem.equilibrium.newton import Newton, NotConverged
from limbcli.fem.equilibrium.settings import Counts, LoadStep, Settings
from limbcli.fem.linear_solvers.singular import SingularMatrix
from limbcli.fem.motion.state import RoughState, State
from limbcli.materials import ogden_type
from limbcli.model import Step

QUICK = Settings(tolerance=1e-6, threads=1)
FAILED = NotConverged("no", where="here", fix="none")
NO_FACTOR = SingularMatrix("no", where="here", fix="none")


def beginning(**newton: object) -> LoadStepping:
    """The stepping of a model, with a solver of which there is only this."""
    system = SimpleNamespace(start=SimpleNamespace(time=0.0), prescribed=lambda known, time: known)
    step = Step(n_steps=10, step_size=0.1)
    return LoadStepping(punch(), step, SimpleNamespace(system=system, counts=Counts(), **newton))


@pytest.mark.parametrize(
    ("changed", "outcome"),
    [
        ({}, IncrementOutcome.SHORTEN),
        ({"exhausted": True}, IncrementOutcome.BEGIN_AGAIN),
        ({"length": 1e-5}, IncrementOutcome.BEGIN_AGAIN),
        ({"exhausted": True, "volume_ratios": False}, IncrementOutcome.HOPELESS),
        ({"exhausted": True, "timed": True}, IncrementOutcome.HOPELESS),
        ({"exhausted": True, "friction": True}, IncrementOutcome.HOPELESS),
        ({"exhausted": True, "brief": True}, IncrementOutcome.HOPELESS),
        ({"brief": True}, IncrementOutcome.SHORTEN),
        ({"error": NO_FACTOR}, IncrementOutcome.HOPELESS),
        ({"error": NO_FACTOR, "n_reached": 2}, IncrementOutcome.SHORTEN),
    ],
)
def test_how_it_goes_on_after_a_failure(changed: dict[str, object], outcome: IncrementOutcome) -> None:
    case = {
        "exhausted": False, "length": 0.1, "volume_ratios": True, "timed": False, "friction": False,
        "brief": False, "error": FAILED, "n_reached": 1, **changed,
    }  # fmt: skip
    stepping = beginning(volume_ratios=case["volume_ratios"])
    stepping._timed, stepping._has_friction = case["timed"], case["friction"]
    stepping._reached = Reached((SimpleNamespace(time=0.0),) * case["n_reached"], 0.1)
    way = LoadStepPath(1.0, LoadStep(1, 1, None), None, case["brief"], 8, None, stepping._reached)
    increment = Increment(0.0, case["length"], 1.0, 0, is_last=False)
    assert stepping._outcome(way, increment, case["error"], case["exhausted"]) is outcome


@pytest.mark.parametrize(
    ("error", "rough", "refused"), [(3.0, True, False), (3.0, False, True), (30.0, True, True)]
)
def test_a_rough_guess_may_be_farther_out(error: float, rough: bool, refused: bool) -> None:
    stepping = beginning(failure=lambda *_: FAILED)
    stepping._reached, stepping._incremental = Reached((SimpleNamespace(time=0.0),) * 2, 0.1), True
    stepping._best = lambda guesses, time: (error, guesses[0], SimpleNamespace())
    known = (RoughState if rough else State)(0.5, np.zeros((4, 3)), ())
    if refused:
        with pytest.raises(NotConverged):
            stepping._guess(0.5, LoadStep(1, 1, None), known, patient=False)
    else:
        assert stepping._guess(0.5, LoadStep(1, 1, None), known, patient=False)[0] is known


@pytest.fixture
def outcomes(monkeypatch: pytest.MonkeyPatch) -> list[IncrementOutcome]:
    found: list[IncrementOutcome] = []
    attempt = LoadStepping._attempt

    def watched(self, way, increment):
        answer = attempt(self, way, increment)
        found.append(answer[0])
        return answer

    monkeypatch.setattr(LoadStepping, "_attempt", watched)
    return found


def test_a_deep_punch_is_cut_comes_to_rest_and_arrives(outcomes: list[IncrementOutcome]) -> None:
    """7.9 of 8 mm: Newton's method fails on the way, the tissue relaxes, and the end is an equilibrium."""
    model = punch("tet4", depth=7.9, levels=1, width=4.0, material=ogden_type(c=0.008, f_kappa=1000.0, m=8.0))
    (last,) = Analysis(model, QUICK).run()
    assert {IncrementOutcome.CONVERGED, IncrementOutcome.SHORTEN, IncrementOutcome.CAME_TO_REST} == set(
        outcomes
    )
    assert last.forces.error <= QUICK.tolerance


@pytest.mark.slow
def test_a_first_load_step_tried_briefly_ends_with_what_is_wrong(outcomes: list[IncrementOutcome]) -> None:
    model = punch("tet10", depth=5.0, levels=1, width=5.0, material=ogden_type(c=0.008, f_kappa=100.0, m=2.0))
    with pytest.raises(SolveError, match="load step 1 of 1"):
        Analysis(model, QUICK).run(end=RunEnd(required=1, full_effort=0))
    assert IncrementOutcome.BEGIN_AGAIN not in outcomes


def test_a_failure_tells_the_time_and_the_depth_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """The depth of the way's own time, which is not that of the load step."""
    model, solve = punch(depth=1.0, levels=1), Newton.equilibrate

    def fails(self, guess, load_step, **options):
        if guess.time > 0.3:
            raise self.failure(self.forces(guess), load_step, 0, "no")
        return solve(self, guess, load_step, **options)

    monkeypatch.setattr(Newton, "equilibrate", fails)
    monkeypatch.setattr(relaxation, "_RELAXED", 0)
    with pytest.raises(SolveError) as caught:
        Analysis(model, QUICK).run()
    reported = re.search(r"\(time (\S+), depth (\S+) mm\)", str(caught.value))
    assert reported, str(caught.value)
    time, depth = (float(each) for each in reported.groups())
    assert time < 0.5
    assert depth == pytest.approx(0.05 + 0.95 * time, abs=0.006)
