"""The table of a joint fit's parameters: every number of c in kPa, its words too."""

from types import SimpleNamespace

import numpy as np

from limbcli.fitting.joint_result import judge_given_c, parameter_table
from limbcli.inference.parameter import FitParameter
from limbcli.inference.profile import Profile


def test_what_is_said_of_c_is_in_kpa():
    none = np.zeros(0)
    profile = Profile("c", none, none, none, 0.005, 0.08, False, True, none)
    problem = SimpleNamespace(profiled=(0,), parameters=[FitParameter("c", 0.008, 0.0008, 0.08, "log")])
    fit = SimpleNamespace(jacobian=np.array([[100.0]]), theta=np.array([0.0075]))
    found = SimpleNamespace(fit=fit, scale=1.0, profiles={"c": profile}, best=np.array([0.0075]))
    table = parameter_table(problem, found)["c_kpa"]
    assert table["headline"] == "above 5.00 kPa"
    assert "the data exclude only values below 5 kPa" in table["words"]


def test_parameters_that_the_data_do_not_tell_apart_have_no_standard_error():
    none, c = np.zeros(0), np.array([1.0, 2.0, 0.5, 3.0])
    alike = np.column_stack([100.0 * c, [1.0, 2.0, 3.0, 4.0], [2.0, 4.0, 6.0, 8.0]])
    parameters = [FitParameter(name, 1.0, 0.1, 10.0, "log") for name in ("c", "f_kappa", "m")]
    profiles = {
        each.name: Profile(each.name, none, none, none, 0.1, 10.0, True, True, none) for each in parameters
    }
    problem = SimpleNamespace(profiled=(0, 1, 2), parameters=parameters)
    best = np.array([0.0075, 1.0, 1.0])
    found = SimpleNamespace(
        fit=SimpleNamespace(jacobian=alike, theta=best), scale=1.0, profiles=profiles, best=best
    )
    table = parameter_table(problem, found)
    assert np.isfinite(table["c_kpa"]["standard_error"])
    assert np.isnan([table[name]["standard_error"] for name in ("f_kappa", "m")]).all()
    assert table["m"]["flag"] == "weak"


def test_c_that_only_a_value_by_hand_tells_is_not_called_identified():
    """Without any speed its interval is that of what was given; speeds that tell it better are heard."""

    def judged(standard_error):
        table = {"value": 8.0, "standard_error": standard_error, "low": 6.6, "high": 9.7,
                 "flag": "identified", "words": "", "headline": ""}  # fmt: skip
        judge_given_c(table, SimpleNamespace(c0=0.008, c_deviation=0.1), 1.0)
        return table

    assert judged(0.4)["flag"] == "identified"
    alone = judged(0.79)
    assert (alone["flag"], alone["headline"]) == ("fixed", "8.00 kPa")
    assert "c is what was given (8 kPa, one deviation 10 %)" in alone["words"]
