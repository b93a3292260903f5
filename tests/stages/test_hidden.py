"""Effects hidden in readings, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.measurement.elastography import SweMap
from limbcli.phantom.noise import Readings
from limbcli.phantom.protocol import TrueLevels
from limbcli.stages.simulated_subjects.hidden_effects import hide


def _true() -> TrueLevels:
    swe = SweMap(np.zeros(3), np.array([5.0, 13.5, 22.0]), np.full(3, 2.0))
    return TrueLevels(np.array([0.0, 2.0, 4.0]), np.array([0.0, 3.0, 5.0]), (swe,) * 3, 30.0)


def _trace() -> np.ndarray:
    """Three holds of 6 s with ramps of 1 s between, at 10 Hz: time, force, depth, accelerations."""
    at = np.array([0.0, 6.0, 7.0, 13.0, 14.0, 20.0])
    time = np.arange(0.0, 20.0, 0.1)
    force, depth = (np.interp(time, at, np.repeat(levels, 2)) for levels in (_true().force, _true().depth))
    return np.column_stack([time, force, depth, np.zeros((len(time), 3))])


def _readings() -> Readings:
    true = _true()
    layers = np.array([[1.5, 5.0]] * 3)
    return Readings(true.force, true.depth, true.maps, 30.0 - true.depth, 6.0, _trace(), layers=layers)


def shown(text: str) -> Readings:
    hidden = hide(text)
    assert hidden.in_readings is not None
    return hidden.in_readings(_readings(), _true())


def test_force_and_depth_effects():
    assert shown("force-zero=1.5").force == pytest.approx([1.5, 3.5, 5.5])
    scaled = shown("depth-gain=1.05")
    assert scaled.depth == pytest.approx(np.array([0, 3, 5]) / 1.05)
    assert scaled.skin_bone == pytest.approx(np.array([30, 27, 25]) / 1.05)
    assert scaled.layers == pytest.approx(np.array([[1.5, 5.0]] * 3) / 1.05)
    late = shown("depth-zero=1.2")
    assert late.depth == pytest.approx([1.8, 3.8])
    assert late.force == pytest.approx([2.0, 4.0])
    pressed = shown("preload=2")
    assert pressed.force == pytest.approx([0.0, 2.0])
    assert pressed.depth == pytest.approx([0.0, 2.0])


def test_a_support_that_gives_way_shows_in_the_travel_alone():
    found = shown("support-motion=0.1")
    assert found.travel == pytest.approx([0.0, 3.2, 5.4], abs=0.4)
    assert found.depth == pytest.approx(_readings().depth)
    assert found.force == pytest.approx(_readings().force)


def test_speed_effects():
    assert shown("swe-time-scale=0.64").maps[0].speed_m_per_s == pytest.approx([2.5] * 3)
    biased = shown("swe-depth-bias=0.02").maps[0].speed_m_per_s
    assert biased == pytest.approx([2 * 1.17, 2.0, 2 * 0.83])
    guided = shown("swe-guided-wave=1").maps
    assert guided[2].speed_m_per_s[0] > guided[0].speed_m_per_s[0] > 2.0


def test_relaxation_leaves_more_force_and_faster_waves():
    found = shown("viscoelasticity=0.3")
    assert found.force[0] == 0.0
    assert np.all(found.force[1:] > _true().force[1:])
    assert found.maps[0].speed_m_per_s == pytest.approx([2 * np.sqrt(1.3)] * 3)
    time, force = found.trace[:, 0], found.trace[:, 1]
    early, late = force[np.abs(time - 7.5).argmin()], force[np.abs(time - 12.9).argmin()]
    assert early > late > 2.0  # it falls while the depth is held
    assert found.trace[:, 2] == pytest.approx(_trace()[:, 2])
    assert late == pytest.approx(found.force[1], rel=0.02)  # as the level's own reading


def test_the_record_is_misread_as_the_levels_are():
    assert shown("force-zero=1.5").trace[:, 1] == pytest.approx(_trace()[:, 1] + 1.5)
    assert shown("depth-zero=1.2").trace[:, 2] == pytest.approx(_trace()[:, 2] - 1.2)
    assert shown("depth-gain=1.05").trace[:, 2] == pytest.approx(_trace()[:, 2] / 1.05)
    assert shown("preload=2").trace[:, 1] == pytest.approx(_trace()[:, 1] - 2.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("skin_layr", "there is no effect"),
        ("force-zero=9", "must be a number from -4 to 4"),
        ("force-zero=much", "must be a number"),
        ("poroelasticity", "cannot be hidden"),
    ],
)
def test_what_cannot_be_hidden_is_said(text, message):
    with pytest.raises(CaseError, match=message):
        hide(text)
