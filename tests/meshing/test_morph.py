"""A mesh moved to another shape: the boundary exactly, the inside smoothly, no cell crushed."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeshError
from limbcli.meshing.morph import aside, deeper, flatter, larger, morphed, sloping, tapered, wider
from limbcli.meshing.regions import quadratic
from limbcli.meshing.rods import Rod
from limbcli.model import Block, Mesh

ROD = Rod(
    np.array([0.0, 0.0, -30.0]), np.array([0.0, 1.0, 0.0]), 10.0, -50.0, 50.0, np.array([0.0, 0.0, 1.0])
)
_TETS = [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]


def block(kind: str = "tet4") -> Mesh:
    """20 x 20 x 20 mm; "bone" its base, "skin" its top."""
    at = np.linspace(-10.0, 10.0, 5)
    points = np.stack([each.ravel() for each in np.meshgrid(at, at, at - 10.0, indexing="ij")], axis=1)
    number = np.arange(125).reshape(5, 5, 5)
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    hexes = np.stack([number[i : i + 4, j : j + 4, k : k + 4].ravel() for i, j, k in corners], axis=1)
    cells = np.concatenate([hexes[:, each] for each in _TETS])
    if kind == "tet10":
        points, cells, _ = quadratic(points, cells)
    sets = {"bone": np.flatnonzero(points[:, 2] < -19.9), "skin": np.flatnonzero(points[:, 2] > -0.1)}
    return Mesh(points, (Block("tissue", kind, cells),), sets)


@pytest.mark.parametrize("kind", ["tet4", "tet10"])
def test_between_two_planes_the_nodes_follow_linearly(kind):
    mesh = block(kind)
    down = np.tile([0.0, 0.0, -2.0], (len(mesh.node_sets["bone"]), 1))
    moved = morphed(mesh, {"bone": down, "skin": np.zeros((len(mesh.node_sets["skin"]), 3))})
    expected = mesh.points[:, 2] + 2.0 * mesh.points[:, 2] / 20.0
    assert moved.points[:, 2] == pytest.approx(expected, abs=1e-9)
    assert moved.points[:, :2] == pytest.approx(mesh.points[:, :2], abs=1e-12)


def test_a_crushed_cell_is_refused():
    mesh = block()
    up = np.tile([0.0, 0.0, 19.0], (len(mesh.node_sets["bone"]), 1))
    with pytest.raises(MeshError, match="would keep"):
        morphed(mesh, {"bone": up, "skin": np.zeros((len(mesh.node_sets["skin"]), 3))})


def test_a_wider_rod_keeps_its_nearest_line_and_a_deeper_one_its_radius():
    angle = np.linspace(0, 2 * np.pi, 13)[:-1]
    points = ROD.centre + 10.0 * np.stack([np.sin(angle), np.full(12, 0.4), np.cos(angle)], axis=1)
    wide = points + wider(points, ROD, 1.4)
    assert wide[0] == pytest.approx(points[0])
    assert np.hypot(wide[:, 0], wide[:, 2] + 34.0) == pytest.approx(14.0)
    assert (points + deeper(points, ROD, 0.3) - points)[:, 2] == pytest.approx(-0.3)


def test_a_flatter_limb_bends_less_where_it_is_touched_and_is_as_long_round():
    angle = np.linspace(0, 2 * np.pi, 721)[:-1]
    skin = 50.0 * np.stack([np.sin(angle), 0 * angle, np.cos(angle) - 1.0], axis=1)
    flat = skin + flatter(skin, ROD, np.zeros(3), 1.7)
    near = flat[[-4, 0, 4]]
    sag = near[1, 2] - 0.5 * (near[0, 2] + near[2, 2])
    assert (near[2, 0] / 1.0) ** 2 / (2 * sag) == pytest.approx(85.0, rel=1e-3)
    around = np.linalg.norm(np.roll(flat, -1, axis=0) - flat, axis=1).sum()
    assert around == pytest.approx(2 * np.pi * 50.0, rel=0.03)


def test_a_sloping_rod_gets_deeper_along_the_limb_and_stays_where_it_is_touched():
    line = np.array([[0.0, y, -20.0] for y in (-10.0, 0.0, 10.0)])
    moved = sloping(line, ROD, np.zeros(3), 0.13)
    np.testing.assert_allclose(moved, [[0, 0, 1.3], [0, 0, 0], [0, 0, -1.3]], atol=1e-12)


def test_a_rod_met_on_its_flank_still_lies_where_the_beam_meets_it():
    angle = np.linspace(0, 2 * np.pi, 721)
    ring = ROD.centre + 10.0 * np.stack([np.sin(angle), np.zeros(721), np.cos(angle)], axis=1)
    there = ring + aside(ring, ROD, np.radians(22.0))
    seen = np.argmin(np.linalg.norm(there - [0.0, 0.0, -20.0], axis=1))
    assert there[seen] == pytest.approx([0.0, 0.0, -20.0], abs=0.05)
    normal = (there[seen] - there[:-1].mean(axis=0)) / 10.0
    assert np.degrees(np.arccos(normal[2])) == pytest.approx(22.0, abs=0.5)


def test_a_tapered_skin_keeps_its_front_line_and_a_larger_one_its_place_touched():
    skin = np.array([[0.0, -10.0, 0.0], [0.0, 10.0, 0.0], [5.0, 10.0, -40.0], [5.0, 0.0, -40.0]])
    away = tapered(skin, ROD, np.zeros(3), 0.01)
    np.testing.assert_allclose(away, [[0, 0, 0], [0, 0, 0], [0.5, 0, -4.0], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(larger(skin, np.zeros(3), 1.1), 0.1 * skin)
