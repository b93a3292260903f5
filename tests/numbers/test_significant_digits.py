"""Large numbers in sentences are written out: 340 N, not 3.4e+02 N."""

from __future__ import annotations

import numpy as np

from limbcli.inference.agreement import force_agreement
from limbcli.inference.identifiability import NoProfile, verdict
from limbcli.inference.parameter import FitParameter
from limbcli.measurement.cycle_changes import CycleChange, _in_words
from limbcli.reporting.sections.assumed_geometry import geometry_tables


def test_a_poor_fit_by_a_slip_of_units_is_written_out():
    residual, deviation = np.full(4, 340.4), np.full(4, 0.5)
    words = force_agreement(residual, deviation, float("nan"), n_free=2).words
    assert "by 340 N (RMSE under load), 681 times" in words


def test_errors_beyond_all_of_the_value_are_written_out():
    m = FitParameter("m", start=2.0, low=1.0, high=50.0)
    assert "standard error 150 %" in verdict(m, 20.0, NoProfile(log_deviation=1.5), influence=True).words
    uncertainty = {"words": "a limb", "standard_error_fraction": {"m": 1.2}, "interval_95": {}}
    parts, _ = geometry_tables("p1", {"geometry_uncertainty": uncertainty})
    assert [row[-1].text for row in parts.rows] == ["–", "120 %"]


def test_change_between_cycles_is_written_out():
    change = CycleChange("compliance", 1.04, 0.12, left=1.0, explains=True)
    assert "softer by 104 % (deviation 12)" in _in_words(change)
