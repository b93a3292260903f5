"""Depths are those of the probe's lowest point, wherever a change has put its centre."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.effects import effect
from limbcli.feb.read import read_feb
from limbcli.stages.indent import _depth


def test_a_turned_probe_is_as_deep_as_its_lowest_edge(golden) -> None:
    model = read_feb(golden / "effect-base-tet4" / "model.feb")
    model = replace(model, bodies=(replace(model.bodies[0], center_of_mass=(0.0, 0.0, 0.0)),))
    tilted = effect("tilt").apply(model, {"tilt_deg": 7.0, "tilt_direction_deg": 0.0})
    lift = tilted.bodies[0].center_of_mass[2]
    assert lift > 0.1
    pressed = SimpleNamespace(probe_depth=lambda body: np.array([3.0, 5.0]) - lift)
    assert _depth(tilted, pressed) == pytest.approx([3.0, 5.0])
    plain = SimpleNamespace(probe_depth=lambda body: np.array([3.0, 5.0]))
    assert _depth(model, plain) == pytest.approx([3.0, 5.0])
