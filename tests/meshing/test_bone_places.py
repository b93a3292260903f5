"""Bones that lost their origin are put back beside those that did not."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from limbcli.meshing.anatomy import limb_check
from limbcli.meshing.bone_places import put_back
from limbcli.meshing.surfaces import Triangles

LOST = ("bone_fibula", "bone_patella")


@pytest.fixture(scope="module")
def leg(make_tube, make_ball) -> dict[str, Triangles]:
    """A right knee and leg: the fibula's head 2.5 mm from the tibia, 18 mm below its top, the patella 5 mm
    before the femur."""
    head = 34.5 * np.array([-np.cos(np.radians(35)), np.sin(np.radians(35))])
    return {
        "skin": make_tube((0, 0, -150), (0, 0, 100), (66, 66)),
        "bone_femur": make_tube((0, 0, 36), (0, 0, 99), (25, 20)),
        "bone_tibia": make_tube((0, 0, -120), (0, 0, 30), (12, 28)),
        "bone_fibula": make_tube((head[0], head[1], -110), (head[0], head[1], 12), (6, 6), around=24),
        "bone_patella": make_ball((0, -43, 60), 15),
    }


def moved(leg: Mapping[str, Triangles], by: tuple[float, float, float], names: tuple[str, ...] = LOST):
    """(right, wrong): those named taken elsewhere."""
    shift = np.eye(4)
    shift[:3, 3] = by
    right = {name: each for name, each in leg.items() if name not in (*names, "skin")}
    return right, {name: leg[name].moved(shift) for name in names}


@pytest.mark.slow
def test_what_was_moved_together_is_put_back_within_5_mm_from_anywhere(leg):
    """Along the limb the height of the fibula's head is anybody's by 5 mm; across it the joint tells more."""
    ends = []
    for by in ((120.0, -40.0, 75.0), (-70.0, 160.0, -50.0)):
        right, wrong = moved(leg, by)
        found = put_back(leg["skin"], right, wrong, limb="right")
        assert found is not None
        assert set(found.names) == set(LOST)
        ends.append(found.move + np.array(by))
        assert np.abs(ends[-1][:2]).max() < 4.0
        assert abs(ends[-1][2]) < 6.0
        assert found.deviation_mm < 6.0
    assert ends[0] == pytest.approx(ends[1], abs=0.3)


@pytest.mark.slow
def test_a_left_leg_is_mirrored(leg):
    flip = np.diag([-1.0, 1.0, 1.0])
    mirrored = {name: Triangles(each.points @ flip, each.faces[:, ::-1].copy()) for name, each in leg.items()}
    right, wrong = moved(mirrored, (80.0, 10.0, 0.0))
    found = put_back(mirrored["skin"], right, wrong, limb="left")
    assert found is not None
    assert np.abs(found.move + np.array([80.0, 10.0, 0.0])).max() < 6.0


def test_nothing_is_proposed_where_nothing_tells(leg):
    """A fibula alone may lie anywhere round the tibia; without a tibia there is nothing to lie beside."""
    right, wrong = moved(leg, (120.0, -40.0, 75.0), ("bone_fibula",))
    del right["bone_patella"]
    assert put_back(leg["skin"], right, wrong, limb="right") is None
    right, wrong = moved(leg, (120.0, -40.0, 75.0))
    del right["bone_tibia"]
    assert put_back(leg["skin"], right, wrong, limb="right") is None


@pytest.mark.slow
def test_nothing_is_proposed_where_it_does_not_fit(leg, make_tube):
    """A skin that has no room for the bones."""
    right, wrong = moved(leg, (120.0, -40.0, 75.0))
    assert put_back(make_tube((0, 0, -150), (0, 0, 100), (30, 30)), right, wrong, limb="right") is None


def test_only_what_lies_outside_is_called_misplaced(leg):
    assert limb_check(leg, limb="right", where="leg").outside == ()
    _, wrong = moved(leg, (120.0, -40.0, 75.0))
    assert limb_check({**leg, **wrong}, limb="right", where="leg").outside == LOST
