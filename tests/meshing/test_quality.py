"""Mesh figures against tetrahedra whose angles are known."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing.improve import worst_sines
from limbcli.meshing.quality import dihedral_angles_deg, scaled_jacobians, tet10_gradient, volumes
from limbcli.meshing.regions import quadratic

CORNER = np.vstack([np.zeros(3), np.eye(3)])
CELL = np.array([[0, 1, 2, 3]])


def test_angles_of_a_corner_tetrahedron():
    angles = np.sort(dihedral_angles_deg(CORNER, CELL)[0])
    assert angles == pytest.approx([*[np.degrees(np.arccos(1 / np.sqrt(3)))] * 3, 90, 90, 90])


def test_smallest_sine_agrees_with_the_angles(rng):
    points = rng.normal(size=(40, 3))
    cells = np.array([rng.choice(40, 4, replace=False) for _ in range(60)])
    negative = volumes(points, cells) < 0
    cells[negative] = cells[negative][:, [0, 2, 1, 3]]
    sines = np.sin(np.radians(dihedral_angles_deg(points, cells))).min(axis=1)
    assert worst_sines(points, cells) == pytest.approx(sines, rel=1e-9)
    assert (worst_sines(points, cells[:, [0, 2, 1, 3]]) < 0).all()


def test_straight_quadratic_cell_has_the_jacobian_of_its_corners(rng):
    points = CORNER + 0.1 * rng.normal(size=(4, 3))
    ten, cells, _ = quadratic(points, CELL)
    assert scaled_jacobians(ten, cells) == pytest.approx(scaled_jacobians(points, CELL), rel=1e-12)


def test_a_mid_node_pushed_through_shows_as_negative_jacobian():
    points, cells, _ = quadratic(CORNER, CELL)
    bent = points.copy()
    bent[cells[0, 4]] = [0.05, 0.0, 0.0]  # beyond the quarter of the edge
    assert scaled_jacobians(bent, cells)[0] < 0 < scaled_jacobians(points, cells)[0]


def test_tet10_gradients_reproduce_a_quadratic_field(rng):
    corners = np.vstack([np.zeros(3), np.eye(3)])
    nodes, _, _ = quadratic(corners, CELL)
    a = rng.normal(size=(3, 3))
    at = np.array([0.2, 0.3, 0.1])
    values = np.einsum("ni,ij,nj->n", nodes, a, nodes)
    order = quadratic(corners, CELL)[1][0]
    assert values[order] @ tet10_gradient(at) == pytest.approx((a + a.T) @ at)
