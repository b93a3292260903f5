"""The table of a joint fit's parameters: every number of c in kPa, its words too."""

from types import SimpleNamespace

import numpy as np

from limbcli.inference.parameter import FitParameter
from limbcli.inference.profile import Profile
from limbcli.stages.fitting.joint_result import parameter_table


def test_what_is_said_of_c_is_in_kpa():
    none = np.zeros(0)
    profile = Profile("c", none, none, none, 0.005, 0.08, False, True, none)
    problem = SimpleNamespace(profiled=(0,), parameters=[FitParameter("c", 0.008, 0.0008, 0.08, "log")])
    fit = SimpleNamespace(jacobian=np.array([[100.0]]), theta=np.array([0.0075]))
    found = SimpleNamespace(fit=fit, scale=1.0, profiles={"c": profile}, best=np.array([0.0075]))
    table = parameter_table(problem, found)["c_kpa"]
    assert table["headline"] == "above 5.00 kPa"
    assert "the data exclude only values below 5 kPa" in table["words"]
