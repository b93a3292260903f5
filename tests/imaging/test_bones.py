"""Names of bones by size and place."""

from __future__ import annotations

import numpy as np

from limbcli.imaging.bones import name_bones
from limbcli.imaging.volume import Volume


def box(i, j, k):
    """A bone as a box in a 40 x 40 x 60 image; j grows towards posterior."""
    values = np.zeros((40, 40, 60), bool)
    values[slice(*i), slice(*j), slice(*k)] = True
    return Volume(values, np.eye(4))


TIBIA = box((10, 22), (8, 20), (0, 30))
FIBULA = box((25, 30), (18, 23), (0, 27))
FEMUR = box((10, 26), (10, 24), (32, 60))
PATELLA = box((12, 20), (1, 5), (33, 41))


def named(*bones):
    ordered = tuple(sorted(bones, key=lambda bone: -int(bone.values.sum())))
    names = name_bones(ordered)
    return {
        name: next(n for n, bone in enumerate(bones) if bone is ordered[m]) for m, name in enumerate(names)
    }


def test_tibia_and_fibula_are_told_apart_by_size():
    assert named(FIBULA, TIBIA) == {"tibia": 1, "fibula": 0}


def test_a_knee_has_four_names():
    assert named(TIBIA, FIBULA, FEMUR, PATELLA) == {"tibia": 0, "fibula": 1, "femur": 2, "patella": 3}


def test_a_knee_without_patella_in_view_has_three():
    assert named(TIBIA, FIBULA, FEMUR) == {"tibia": 0, "fibula": 1, "femur": 2}


def test_bones_that_fit_no_pattern_are_numbered():
    assert set(named(TIBIA)) == {"1"}
    twin = box((25, 37), (8, 20), (0, 30))
    assert set(named(TIBIA, twin)) == {"1", "2"}
    behind = box((12, 20), (30, 34), (33, 41))
    assert set(named(TIBIA, FIBULA, FEMUR, behind)) == {"1", "2", "3", "4"}
