"""Cuts for pictures are exact where they can be."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.reporting.figures.section import (
    cut_tetrahedra,
    cut_triangles,
    linear_tetrahedra,
    linear_triangles,
    on_edges,
)

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1.0]])
# The unit cube as six tetrahedra around its diagonal 0-7.
CUBE = np.array(
    [[0, 1, 4, 7], [0, 4, 2, 7], [0, 2, 6, 7], [0, 6, 3, 7], [0, 3, 5, 7], [0, 5, 1, 7]]
)  # fmt: skip


def area(corners: np.ndarray) -> float:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return float(0.5 * np.linalg.norm(np.cross(a, b), axis=1).sum())


@pytest.mark.parametrize("height", [0.2, 0.5, 0.77])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_cut_of_a_cube_has_area_one(axis, height):
    points = np.roll(CORNERS, 1 - axis, axis=1) - [0.0, height, 0.0]
    cut = cut_tetrahedra(points, CUBE)
    corners = cut.at(points)
    np.testing.assert_allclose(corners[:, 1], 0.0, atol=1e-8)
    assert area(corners[cut.triangles]) == pytest.approx(1.0, abs=1e-6)


def test_a_plane_through_nodes_cuts_once():
    """Two cubes on either side of y = 0: their common face is the cut."""
    points = np.concatenate([CORNERS, CORNERS * [1, -1, 1]])
    cut = cut_tetrahedra(points, np.concatenate([CUBE, CUBE + 8]))
    assert area(cut.at(points)[cut.triangles]) == pytest.approx(1.0, abs=1e-6)


def test_linear_fields_are_exact_on_a_cut_of_random_tetrahedra(rng):
    points = rng.normal(size=(60, 3))
    cells = rng.permutation(60)[:56].reshape(14, 4)
    cut = cut_tetrahedra(points, cells)
    weights = rng.normal(size=3)
    np.testing.assert_allclose(cut.at(points @ weights), cut.at(points) @ weights, atol=1e-12)
    assert set(cut.cells) <= set(range(14))


def test_quadrilateral_cuts_do_not_cross_themselves(rng):
    """Area by corners' order equals the area of their convex hull."""
    from scipy.spatial import ConvexHull

    for _ in range(40):
        points = rng.normal(size=(4, 3))
        cut = cut_tetrahedra(points, np.arange(4)[None])
        if len(cut.triangles) != 2:
            continue
        corners = cut.at(points)
        assert area(corners[cut.triangles]) == pytest.approx(ConvexHull(corners[:, ::2]).volume, rel=1e-9)


def test_tet10_parts_fill_the_cell_once():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    points = np.concatenate([corners, [(corners[a] + corners[b]) / 2 for a, b in pairs]]) - [0, 0.3, 0]
    parts, parent = linear_tetrahedra("tet10", np.arange(10)[None])
    x = points[parts]
    edges = x[:, 1:] - x[:, :1]
    volumes = np.abs(np.linalg.det(edges)) / 6
    np.testing.assert_allclose(volumes, 1 / 48)
    assert np.all(parent == 0)
    cut = cut_tetrahedra(points, parts)
    assert area(cut.at(points)[cut.triangles]) == pytest.approx(0.5 * 0.7**2, rel=1e-7)


def test_tri6_parts_fill_the_facet():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0.0]])
    parts = linear_triangles("tri6", np.arange(6)[None])
    assert area(points[parts]) == pytest.approx(0.5)


def test_facets_are_cut_to_segments_on_the_plane():
    points = np.array([[0, -1, 0], [0, 1, 0], [2, 1, 0], [2, -1, 0.0]])
    ends, weight = cut_triangles(points, linear_triangles("quad4", np.arange(4)[None]))
    segments = on_edges(ends, weight, points)
    np.testing.assert_allclose(segments[..., 1], 0, atol=1e-8)
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(2.0, abs=1e-6)


def test_other_cells_are_refused():
    with pytest.raises(ValueError, match="hex8"):
        linear_tetrahedra("hex8", np.arange(8)[None])
