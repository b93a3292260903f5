"""What is said of the stretches of a fit of several states."""

from types import SimpleNamespace

import pytest

from limbcli.fitting.states_result import _with_stretches_judged

NAME = "unloaded_stretch_around"


@pytest.mark.parametrize(
    ("low", "high", "message", "flag"),
    [(0.9, 1.0, "0.950", "identified"), (0.8, 1.2, "0.950 (weakly, 0.800 to 1.20)", "weak")],
)
def test_headline_and_flag_of_a_stretch_are_one_verdict(low, high, message, flag):
    found = {"value": 0.95, "low": low, "high": high, "flag": "identified", "headline": "0.950", "words": ""}
    plan = SimpleNamespace(parameters=[SimpleNamespace(name=NAME)])
    judged = _with_stretches_judged({NAME: found}, plan)[NAME]
    assert (judged["headline"], judged["flag"]) == (message, flag)
