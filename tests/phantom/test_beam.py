"""The skin-bone distance under the probe's centre."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.model import LimbModel, Mesh, Surface
from limbcli.phantom.beam import skin_bone_distance


def model(bone_x=0.0):
    plate = np.array([[-20.0, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0]])
    skin = plate + np.array([0, 0, -0.5])
    bone = plate * 0.4 + np.array([bone_x, 0, 0])
    bone[:, 2] = -30.0 + 0.1 * bone[:, 0]  # slanted
    points = np.vstack([skin, bone, bone - np.array([0, 0, 12.0])])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return LimbModel(
        mesh=Mesh(
            points=points,
            blocks=(),
            surfaces={
                "skin": Surface("skin", {"tri3": triangles}),
                "bone": Surface("bone", {"tri3": triangles + 4, "quad4": np.array([[8, 9, 10, 11]])}),
            },
        ),
        materials={},
        domains=(),
    )


def test_distance_is_to_the_first_bone_surface_below():
    assert skin_bone_distance(model()) == pytest.approx(29.5)
    assert skin_bone_distance(model(bone_x=5.0)) == pytest.approx(29.5)


def test_a_beam_that_passes_the_bone_has_no_distance():
    assert skin_bone_distance(model(bone_x=30.0)) is None
