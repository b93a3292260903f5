"""Load curves as FEBio reads them.

tests/data/febio-load-curves.json holds the displacements of cubes that FEBio 4.11 moved along such curves.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from limbcli.fem.equilibrium.solve_times import step_times
from limbcli.fem.motion.load_curves import value
from limbcli.model import Curve, Step

POINTS = ((0.0, 0.0), (1.0, 2.0), (2.0, 3.0), (4.0, 1.0))


def test_linear_curve_meets_its_points_and_their_middles() -> None:
    curve = Curve(POINTS)
    assert [value(curve, t) for t, _ in POINTS] == [v for _, v in POINTS]
    assert [value(curve, t) for t in (0.5, 1.5, 3.0)] == [1.0, 2.5, 2.0]


def test_step_curve_takes_the_next_points_value() -> None:
    curve = Curve(POINTS, "step")
    assert [value(curve, t) for t in (0.0, 0.3, 1.0, 1.7, 3.9, 4.0)] == [0.0, 2.0, 3.0, 3.0, 1.0, 1.0]


@pytest.mark.parametrize("times", [(0.0, 1.0, 2.5), (0.0, 0.5, 1.5, 2.0, 3.5)])
def test_smooth_curve_is_exact_on_a_parabola(times: tuple[float, ...]) -> None:
    def law(t: float) -> float:
        return 1.0 - 0.7 * t + 0.4 * t**2

    curve = Curve(tuple((t, law(t)) for t in times), "smooth")
    for t in np.linspace(times[0], times[-1], 23):
        assert value(curve, t) == pytest.approx(law(t), abs=1e-12)


def test_smooth_curve_blends_two_parabolas() -> None:
    """Between (1, 2) and (2, 3), half-way: the mean of that through the point before and after."""
    left = 2 * 1.5 - 0.5 * 1.5 * 0.5
    right = 2.0 + 0.5 + (-1.0 - 1.0) / 3.0 * 0.5 * -0.5
    assert value(Curve(POINTS, "smooth"), 1.5) == pytest.approx(0.5 * (left + right))


def test_extensions() -> None:
    assert value(Curve(POINTS), 9.0) == 1.0
    assert value(Curve(POINTS, extend="extrapolate"), 5.0) == 0.0
    assert value(Curve(POINTS, "step", "extrapolate"), 5.0) == 1.0
    assert value(Curve(POINTS, extend="repeat"), 8.5) == 1.0
    assert value(Curve(POINTS, extend="repeat"), 8.0) == 1.0
    assert value(Curve(POINTS, extend="repeat offset"), 8.5) == 3.0
    assert value(Curve(POINTS, extend="repeat offset"), -0.5) == pytest.approx(0.5)
    slope = value(Curve(((0.0, 0.0), (1.0, 1.0), (2.0, 4.0)), "smooth", "extrapolate"), 3.0)
    assert slope == pytest.approx(8.0, abs=0.01)  # 2 t at t = 2


FEBIO = json.loads((Path(__file__).parents[1] / "data/febio-load-curves.json").read_text())


@pytest.mark.parametrize("extend", ["constant", "extrapolate", "repeat", "repeat offset"])
def test_curves_have_febio_s_values_at_its_own_times(extend: str) -> None:
    """A period of 0.7 s ends after seven steps of 0.1 s, one of 0.3 s begins anew after three: round-off."""
    times: list[float] = []
    for n_steps, size in FEBIO["steps"]:
        step = Step(n_steps=n_steps, step_size=size, adaptive=False)
        times += step_times(step, begin=times[-1] if times else 0.0)
    mine = [each for each in FEBIO["curves"] if each["extend"] == extend]
    assert len(mine) == 18
    for each in mine:
        curve = Curve(tuple(map(tuple, each["points"])), each["interpolate"], extend)
        found = [value(curve, time) for time in times]
        assert found == pytest.approx(each["values"], abs=2e-9), (each["interpolate"], each["points"])


def test_a_curve_of_very_many_periods_is_not_counted_through() -> None:
    assert value(Curve(((0.0, 0.0), (1e-9, 1.0)), extend="repeat offset"), 1.0) == pytest.approx(1e9)
