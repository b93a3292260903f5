"""Places in a model that effects ask for: how thick the tissue is below the probe, how the limb lies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.effects.tissue import limb_axis, thickness
from limbcli.model import Surface
from tests.diagnosis.reduced import block_model


def with_bone(*planes):
    """The block with one large triangle for each (height at the origin, slope along x)."""
    corners = np.array([[-50.0, -40.0], [70.0, -40.0], [0.0, 80.0]])
    points = [np.column_stack([corners, z + slope * corners[:, 0]]) for z, slope in planes]
    model = block_model()
    first = len(model.mesh.points)
    facets = first + np.arange(3 * len(planes)).reshape(-1, 3)
    surfaces = {**model.mesh.surfaces, "bone": Surface("bone", {"tri3": facets})}
    mesh = replace(model.mesh, points=np.concatenate([model.mesh.points, *points]), surfaces=surfaces)
    return replace(model, mesh=mesh)


@pytest.mark.parametrize(
    ("planes", "depth"),
    [
        ([(-20.0, 0.0)], 20.0),
        ([(-20.0, 0.4)], 20.0),  # where the beam meets it, not its mean or nearest corner
        ([(-31.0, 0.2), (-18.0, -0.3)], 18.0),  # the bone's far side is behind its near one
        ([(-18.0, -0.3), (-31.0, 0.2)], 18.0),
        ([(5.0, 0.0), (-18.0, 0.0)], 18.0),  # nothing above the skin is below the probe
    ],
)
def test_the_tissue_ends_where_the_beam_first_meets_bone(planes, depth):
    assert thickness(with_bone(*planes)) == pytest.approx(depth)


@pytest.mark.parametrize("move", [(60.0, 0.0), (-80.0, 0.0), (0.0, 50.0), (0.0, -90.0), (-40.0, -40.0)])
def test_a_bone_beside_the_beam_is_no_end_of_the_tissue(move):
    model = with_bone((-20.0, 0.0))
    points = model.mesh.points.copy()
    points[-3:, :2] += move
    assert np.isnan(thickness(replace(model, mesh=replace(model.mesh, points=points))))


def test_a_slab_without_bone_is_as_thick_as_its_support_is_deep():
    assert thickness(block_model(height=25.0)) == pytest.approx(25.0)


def test_the_limb_runs_from_head_to_foot_in_the_plane_of_the_skin():
    """A model turned by 30 degrees about its beam, and tipped: the patient's axis as the model sees it."""
    turn, tip = np.deg2rad(30.0), np.deg2rad(20.0)
    about_z = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(tip), -np.sin(tip)], [0.0, np.sin(tip), np.cos(tip)]])
    upright = np.array(
        [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
    )  # the model's y is the head's way
    patient_from_model = np.eye(4)
    patient_from_model[:3, :3] = upright @ about_x @ about_z
    model = replace(block_model(), info={"patient_from_model": patient_from_model.ravel().tolist()})
    assert limb_axis(model) == pytest.approx((np.sin(turn), np.cos(turn), 0.0))
