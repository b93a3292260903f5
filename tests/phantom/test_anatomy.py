"""The phantom's shapes: where they are, what is in them, and their surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.phantom import shapes, truth
from limbcli.phantom.anatomy import Anatomy, Tissue, random_anatomy
from limbcli.phantom.subject import PLACES, make_subject


@pytest.fixture(scope="module")
def subject():
    return make_subject(np.random.default_rng(7))


def volume_and_edges(surface):
    corner = surface.points[surface.faces]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6
    edges = np.sort(surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    return volume, count


def test_rounded_intersection_rounds_a_right_edge_by_its_radius():
    a = np.linspace(-1, 1, 401)
    diagonal = shapes.rounded_intersection(a, a, radius=2.0)
    assert np.interp(0.0, diagonal, a) == pytest.approx(-2 * (1 - np.sqrt(0.5)), abs=1e-4)


def test_projection_lands_on_the_surface(rng):
    anatomy = Anatomy()
    points = rng.uniform([-50, -45, 10], [50, 45, 150], (200, 3))
    on_skin = shapes.project(anatomy.skin, points[np.hypot(points[:, 0], points[:, 1]) > 20])
    assert np.abs(anatomy.skin(on_skin)).max() < 1e-9


def test_tissues_lie_in_the_order_of_a_limb():
    anatomy = Anatomy()
    point, normal = anatomy.skin_point(angle_deg=90.0, height=80.0)
    depths = np.array([-1.0, 0.5, 4.0, 15.0])
    found = anatomy.classify(point - depths[:, None] * normal)
    assert [Tissue(each).name for each in found] == ["AIR", "SKIN", "FAT", "MUSCLE"]
    tibia = np.array([anatomy.tibia.x - 1.6, anatomy.tibia.y - 1.2, 80.0])
    across = tibia + np.array([[0.0, 0, 0], [0, 10.0, 0]])
    assert [Tissue(each).name for each in anatomy.classify(across)] == ["MARROW", "CORTEX"]


def test_bones_end_inside_the_limb():
    anatomy = Anatomy()
    axis = np.array([[anatomy.tibia.x, anatomy.tibia.y, z] for z in (5.0, 15.0, 35.0, 60.0)])
    assert (anatomy.tibia(axis) < 0).tolist() == [False, False, True, True]
    assert (anatomy.skin(axis) < 0).all()


@pytest.mark.parametrize("seed", range(6))
def test_every_seed_keeps_bones_inside_the_skin_and_apart(seed):
    anatomy = random_anatomy(np.random.default_rng(seed))
    grid = np.stack(np.meshgrid(*[np.arange(-50, 51, 2.0)] * 2, np.arange(20, 160, 4.0)), axis=-1)
    points = grid.reshape(-1, 3)
    tibia, fibula = anatomy.tibia(points), anatomy.fibula(points)
    assert anatomy.skin(points[(tibia < 0) | (fibula < 0)]).max() < -5.0
    assert (tibia + fibula).min() > 2.0  # between them there is tissue


def test_truth_surfaces_are_closed_outward_and_on_the_shapes(subject):
    anatomy = subject.anatomy
    found = truth.surfaces(subject, edge=3.0)
    assert sorted(found) == ["bone_fibula", "bone_tibia", "skin"]
    for name, shape in (("skin", anatomy.skin), ("bone_tibia", anatomy.tibia)):
        surface = found[name]
        volume, count = volume_and_edges(surface)
        assert (count == 2).all()
        assert volume > 0
        below_cut = subject.grid.beyond_last_slice(surface.points) < -6.0
        off = shape(in_limb(subject, surface.points[below_cut]))
        assert np.abs(off).max() < 0.02


def in_limb(subject, points):
    return (points - subject.patient_from_limb[:3, 3]) @ subject.patient_from_limb[:3, :3]


def test_sites_are_on_the_skin_and_the_marker_lies_on_the_first(subject):
    for place in PLACES:
        position = subject.position(place)
        assert abs(subject.anatomy.skin(in_limb(subject, position[None]))[0]) < 1e-9
    marker = subject.marker_positions()[0]
    assert 2.0 < np.linalg.norm(marker - subject.position(PLACES[0])) < 4.0


def test_the_image_holds_the_whole_limb_and_its_markers(subject):
    grid = subject.grid
    surface = truth.surfaces(subject, edge=4.0)["skin"]
    index = (surface.points - grid.origin) @ grid.axes.T / grid.spacing
    assert (index.min(axis=0) > 3 / grid.spacing).all()
    assert (index[:, :2].max(axis=0) < np.array(grid.shape[:2]) - 4).all()
    assert grid.axes @ grid.axes.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.degrees(np.arccos(grid.axes[2, 2])) > 1.0  # oblique
