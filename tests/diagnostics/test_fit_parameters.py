"""What of a fit's parameters ended on a bound, and what that says."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.effects import effect
from limbcli.stages.diagnosis.forward_model.fit_parameters import Slot, bound_hits, stuck

CASES = [
    ("nonlinearity", {"weight_q": 0.0, "second_pair_share": 0.0}, ""),  # a law with one of its two terms
    ("nonlinearity", {"weight_q": 0.5, "second_pair_share": 0.0}, ""),  # q is free, and may be anything
    ("nonlinearity", {"weight_q": 0.7, "second_pair_share": 0.6}, ""),  # q is free and says it is there
    ("contraction", {"active_stress_per_c": 4.0}, "higher bound 4"),
    ("contraction", {"active_stress_per_c": 0.0}, "ended at 0, where the effect is absent"),
    ("inclusion", {"log_inclusion_ratio": 1.0, "inclusion_x_mm": 26.0}, ""),  # a place is no size
    ("inclusion", {"log_inclusion_ratio": 3.0}, "higher bound 3"),
    ("inclusion", {"inclusion_radius_mm": 16.0}, "higher bound 16"),  # as wide as the window: no spot
    ("adipose-layer", {"fat_thickness_mm": 20.0}, "higher bound 20"),
    ("adipose-layer", {"fat_thickness_mm": 1.5}, ""),  # thin: less of it
]


@pytest.mark.parametrize(("name", "values", "message"), CASES)
def test_a_size_on_the_bound_of_the_search_is_told_and_one_at_a_laws_own_limit_is_not(name, values, message):
    known = effect(name)
    slots = [Slot(each.name, each) for each in known.parameters]
    x = np.array([0.0, 0.0, *(values.get(each.name, each.start) for each in known.parameters)])
    found = bound_hits(x, slots, [known])
    assert bool(found) == bool(message)
    assert all(message in each.message for each in found)
    assert all(each.is_absent == ("absent" in message) for each in found)


def test_what_a_bound_holds_does_not_move_with_the_data():
    known = effect("nonlinearity")
    slots = [Slot(each.name, each) for each in known.parameters]
    assert stuck(np.array([0.0, 0.0, 0.0, 0.3]), slots).tolist() == [True, False]
