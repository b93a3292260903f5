"""What a parameter of a fit is: its prior, and what is reported where it ended on a bound."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnosis.forward_model.predictions import Slot
from limbcli.effects import EFFECTS, effect

CASES = [
    ("nonlinearity", "weight_q", 0.0, ""),  # a law with one of its two terms
    ("contraction", "active_stress_per_c", 4.0, "higher bound 4"),
    ("contraction", "active_stress_per_c", 0.0, ""),  # no contraction: its prior reaches that far
    ("inclusion", "inclusion_x_mm", 3.0, ""),
    ("inclusion", "log_inclusion_ratio", 3.0, "higher bound 3"),
    ("adipose-layer", "fat_thickness_mm", 20.0, "higher bound 20"),
    ("adipose-layer", "fat_thickness_mm", 8.0, ""),
]


@pytest.mark.parametrize(("name", "parameter", "value", "message"), CASES)
def test_a_value_on_a_bound_of_the_search_is_told_and_one_at_null_or_a_laws_own_limit_is_not(
    name, parameter, value, message
):
    (slot,) = [Slot(each.name, each) for each in effect(name).parameters if each.name == parameter]
    found = slot.on_bound(value)
    assert bool(found) == bool(message)
    assert message in found


def test_the_prior_of_a_size_is_centred_on_no_effect_and_one_and_a_half_plausible_sizes_wide():
    """Whatever the sign of a plausible size; a shape may be anywhere between its bounds."""
    for p in (p for each in EFFECTS for p in each.parameters):
        prior = Slot(p.name, p).prior
        assert (prior.low, prior.high) == (p.low, p.high)
        if p.shape:
            assert np.isinf(prior.deviation)
        else:
            assert prior.mean == p.null
            assert prior.deviation == pytest.approx(1.5 * abs(p.typical - p.null))
            assert prior.low <= prior.mean <= prior.high
