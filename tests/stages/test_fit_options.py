"""What a fit remembers of its options can be given to it again."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from limbcli.fitting.options import COMPARISON, FitOptions, check_choice
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.two_step_fit import CurveMatch
from limbcli.progress import SILENT
from limbcli.provenance.remaking_command import CommandStep
from limbcli.results import StageResult
from limbcli.stages import fit as stage
from limbcli.stages import fit_elements, fit_states

ALL = FitOptions(
    c_kpa=8.0, c_deviation=0.2, tolerance=0.01, max_iterations=9, intervals=False, gain_deviation=0.1,
    contact_check=False, boundary_check=False, cycle="1", templates=Path("own"), time_limit_s=60.0,
)  # fmt: skip
CASE = SimpleNamespace(subject="S1", selected=lambda _: [SimpleNamespace(name="p1", states=(1, 2))])


@pytest.mark.parametrize("kind", ["force", "joint", "states", COMPARISON])
def test_options_of_every_kind_of_fit_are_taken_again(kind):
    given = ALL.requested(kind)
    compared = kind == COMPARISON
    objective = "force" if compared else kind
    check_choice(objective, FitOptions(**given), compare_element=compared)
    assert {"contact_check", "boundary_check"} <= set(given) or kind in ("states", COMPARISON)


def test_states_fitted_after_the_force_remember_only_what_speaks_to_them(tmp_path, monkeypatch):
    monkeypatch.setattr(fit_states, "_fit_site", lambda *_: None)
    monkeypatch.setattr(fit_states, "noted", lambda case, _: case)
    (made,) = fit_states.fit_states(
        CASE, out=tmp_path, options=FitOptions(c_kpa=8.0, contact_check=False, boundary_check=False)
    )
    assert made.data["asked"] == {}


def test_a_comparison_made_from_python_does_too(tmp_path, monkeypatch):
    monkeypatch.setattr(fit_elements, "_compare_site", lambda *_: None)
    monkeypatch.setattr(fit_elements, "noted", lambda case, _: case)
    requested = FitOptions(c_kpa=8.0, contact_check=False, boundary_check=False)
    (made,) = fit_elements.compare_elements(CASE, out=tmp_path, options=requested)
    assert made.data["asked"] == {"c_kpa": 8.0}


def test_a_comparison_of_laws_is_asked_for_again():
    data = {"law": "ogden", "laws": [{"law": "ogden"}], "sites": ["p1"], "asked": {"gain_deviation": None}}
    made = StageResult(stage="fit-joint", subject="S1", folder=Path("out"), data=data)
    message = CommandStep.of(made).command(Path("limb"), Path("out"))
    assert message == "limbcli fit limb --objective joint --site p1 --out out --law ogden --compare-laws"


def test_a_second_search_for_intervals_announces_its_own_simulations(monkeypatch):
    """The first is of the noise, the second of the assumed geometry too: no "solve 23 of at most 22"."""
    curve, told = SimpleNamespace(n_solves=0, at_most=None), []
    monkeypatch.setattr(stage, "force_intervals", lambda *_, **__: told.append(curve.at_most))
    step = SimpleNamespace(theta=None)
    for curve.n_solves in (8, 22):
        match = CurveMatch(SolvedPoints(curve), None, None)
        stage._intervals(match, [None, None], [step, step], max_solves=12, progress=SILENT)
    assert told == [22, 22, 36, 36]
