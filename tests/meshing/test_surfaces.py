"""Reading and sorting triangle surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeshError
from limbcli.meshing.surfaces import Triangles, bodies, boundary_loops, join, read_surface


def test_volume_of_a_cylinder(make_tube):
    tube = make_tube((0, 0, 0), (0, 0, 10), (5, 5), around=200)
    assert tube.volume == pytest.approx(np.pi * 25 * 10, rel=1e-3)
    assert tube.flipped().volume == pytest.approx(-tube.volume)


def test_bodies_come_apart_largest_first(make_ball):
    small, large = make_ball((50, 0, 0), 5.0), make_ball((0, 0, 0), 20.0)
    found = bodies(join([small, large]))
    assert [len(each.points) for each in found] == [len(large.points), len(small.points)]
    assert np.ptp(found[0].points, axis=0) == pytest.approx([40, 40, 40], rel=0.01)


def test_open_tube_has_two_rims(make_tube):
    rims = boundary_loops(make_tube((0, 0, 0), (0, 0, 10), (5, 5), around=30, closed=False))
    assert sorted(len(each) for each in rims) == [30, 30]
    assert boundary_loops(make_tube((0, 0, 0), (0, 0, 10), (5, 5))) == []


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj"])
def test_surface_survives_writing_and_reading(make_ball, tmp_path, suffix):
    import meshio

    ball, path = make_ball((1, 2, 3), 10.0), tmp_path / f"ball.{suffix}"
    meshio.Mesh(ball.points, [("triangle", ball.faces)]).write(path)
    back = read_surface(path)
    assert len(back.points) == len(ball.points)
    assert back.volume == pytest.approx(ball.volume, rel=1e-5)


def test_absent_and_unreadable_files_say_what_to_do(tmp_path):
    with pytest.raises(MeshError, match="does not exist"):
        read_surface(tmp_path / "no.stl")
    (tmp_path / "bad.ply").write_text("nonsense")
    with pytest.raises(MeshError, match="cannot be read"):
        read_surface(tmp_path / "bad.ply")


def test_triangles_that_do_not_meet_are_told(make_ball, tmp_path, rng):
    import meshio

    corners = make_ball((0, 0, 0), 10.0).corners.reshape(-1, 3)
    loose = corners + rng.uniform(-1e-4, 1e-4, corners.shape)
    path = tmp_path / "skin.stl"
    meshio.Mesh(loose, [("triangle", np.arange(len(loose)).reshape(-1, 3))]).write(path)
    with pytest.raises(MeshError, match="do not meet") as caught:
        read_surface(path)
    assert "Merge Close Vertices" in caught.value.fix


def test_a_cloud_of_points_is_told(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 2\n"
    lines = "".join(f"property float {each}\n" for each in "xyz")
    (tmp_path / "scan.ply").write_text(f"{head}{lines}end_header\n0 0 0\n1 1 1\n")
    with pytest.raises(MeshError) as caught:
        read_surface(tmp_path / "scan.ply")
    assert "points alone" in caught.value.fix


def test_part_leaves_out_unused_points():
    square = Triangles(np.eye(4, 3), np.array([[0, 1, 2], [0, 2, 3]]))
    assert len(square.part(np.array([True, False])).points) == 3


def test_faces_of_many_corners_are_read_as_well(tmp_path):
    """A prism on a hexagon of 10 mm: its ends are drawn as one face each, as drawing programs leave them."""
    angle = np.pi / 3 * np.arange(6)
    ring = 10.0 * np.c_[np.cos(angle), np.sin(angle)]
    points = np.vstack([np.c_[ring, np.zeros(6)], np.c_[ring, np.full(6, 20.0)]])
    sides = [f"f {k + 1} {(k + 1) % 6 + 1} {(k + 1) % 6 + 7} {k + 7}" for k in range(6)]
    ends = ["f 6 5 4 3 2 1", "f 7 8 9 10 11 12"]
    path = tmp_path / "prism.obj"
    path.write_text("\n".join([*(f"v {x} {y} {z}" for x, y, z in points), *sides, *ends]) + "\n")
    surface = read_surface(path)
    assert boundary_loops(surface) == []
    assert surface.volume == pytest.approx(1.5 * np.sqrt(3.0) * 100.0 * 20.0)


def test_a_whole_surface_is_worked_through_once(make_ball):
    """A scan of millions of triangles goes through dozens of checks."""
    ball = make_ball((0, 0, 0), 20.0)
    assert ball.area_vectors is ball.area_vectors
    assert ball.centroids is ball.centroids
    assert bodies(ball)[0] is ball
    with pytest.raises(ValueError, match="read-only"):
        ball.centroids[0] = 0.0


def test_a_scan_of_many_fragments_is_gone_through_once(make_ball, monkeypatch):
    scan = join([make_ball((0, 0, 50.0 * k), 5.0) for k in range(20)])
    taken, part = [], Triangles.part
    monkeypatch.setattr(Triangles, "part", lambda whole, keep: taken.append(len(keep)) or part(whole, keep))
    assert len(bodies(scan)) == 20
    assert sum(taken) == len(scan.faces)
