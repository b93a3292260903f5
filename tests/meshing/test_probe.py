"""The rigid probe's facets."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.meshing.probe import ProbeShape, check_shape, probe_mesh
from limbcli.meshing.surfaces import Triangles, boundary_loops

SHAPE = ProbeShape(53.0, 14.0, 3.0)


def facets_of(shape: ProbeShape) -> Triangles:
    mesh = probe_mesh(shape)
    return Triangles(mesh.points, np.vstack([mesh.quads[:, [0, 1, 2]], mesh.quads[:, [0, 2, 3]], mesh.tips]))


@pytest.fixture(scope="module")
def surface() -> Triangles:
    return facets_of(SHAPE)


def test_open_only_at_the_top(surface):
    rims = boundary_loops(surface)
    assert len(rims) == 1
    assert surface.points[rims[0], 2] == pytest.approx(np.full(len(rims[0]), SHAPE.wall))


def test_size_is_that_of_the_probe(surface):
    assert surface.points.min(axis=0) == pytest.approx([-26.5, -7, 0])
    assert surface.points.max(axis=0) == pytest.approx([26.5, 7, SHAPE.wall])


def test_normals_point_out(surface):
    outward = surface.centroids - [0, 0, SHAPE.wall / 2]
    flat = np.clip(surface.centroids, [-23.5, -4, 0], [23.5, 4, 0])
    outward = np.where((surface.centroids[:, 2] < 3)[:, None], surface.centroids - flat - [0, 0, 3], outward)
    assert (np.einsum("ij,ij->i", surface.area_vectors, outward) > 0).all()


def test_nodes_lie_on_the_rounded_face(surface):
    low = surface.points[surface.points[:, 2] < 3.0 - 1e-9]
    assert low[:, 2] == pytest.approx(SHAPE.rise(low[:, 0], low[:, 1]), abs=1e-6)


@pytest.mark.parametrize("shape", [SHAPE, ProbeShape(30.0, 14.0, 6.9), ProbeShape(41.0, 41.0, 20.0)])
def test_facets_leave_the_rounding_by_less_than_a_twentieth_of_a_millimetre(shape):
    surface, r = facets_of(shape), shape.edge_radius
    c = surface.centroids[surface.centroids[:, 2] < r - 0.1]
    low, high = [*(-each for each in shape.flat), r], [*shape.flat, r]
    flat = np.clip(c, low, high)
    inside = r - np.linalg.norm(c - flat, axis=1)[np.linalg.norm(c[:, :2] - flat[:, :2], axis=1) > 1e-9]
    assert inside.max() < 0.05


def test_an_edge_radius_without_face_is_refused():
    with pytest.raises(CaseError, match="no flat face"):
        check_shape(ProbeShape(50, 6, 3))
