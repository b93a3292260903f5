"""Closed surfaces of masks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from limbcli.errors import CaseError, MeshError
from limbcli.imaging.surface import joined, read_surface, surface_of, write_surface
from limbcli.imaging.volume import Volume
from limbcli.meshing.surfaces import Triangles, bodies


def cylinder(*, spacing=(1.0, 1.0, 3.0), shape=(60, 60, 20), radius=22.0, mirrored=False):
    affine = np.eye(4)
    affine[:3, :3] = Rotation.from_euler("xyz", [5, 9, -14], degrees=True).as_matrix() * np.array(spacing)
    if mirrored:
        affine[:3, 0] *= -1
    index = np.indices(shape)
    x, y = ((index[n] - (shape[n] - 1) / 2) * spacing[n] for n in range(2))
    return Volume(np.hypot(x, y) < radius, affine)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_cylinder_through_the_image_is_closed_with_its_true_volume(mirrored):
    surface = surface_of(cylinder(mirrored=mirrored), edge=2.5)
    assert surface.is_closed
    assert len(bodies(surface)) == 1
    assert surface.volume == pytest.approx(np.pi * 22.0**2 * 60.0, rel=0.01)


def test_its_caps_are_flat_on_the_outer_faces_of_the_image():
    mask = cylinder()
    surface = surface_of(mask, edge=2.5)
    k = mask.to_voxel(surface.points)[:, 2]
    assert (k.min(), k.max()) == pytest.approx((-0.5, 19.5), abs=1e-5)
    on_caps = (np.abs(k + 0.5) < 1e-4) | (np.abs(k - 19.5) < 1e-4)
    assert on_caps.mean() > 0.15


def test_smoothing_does_not_shrink_a_thin_bone():
    mask = cylinder(radius=5.0, shape=(24, 24, 20))
    surface = surface_of(mask, edge=1.5)
    middle = mask.to_patient(np.array([[11.5, 11.5, 0.0], [11.5, 11.5, 19.0]]))
    axis = (middle[1] - middle[0]) / np.linalg.norm(middle[1] - middle[0])
    offset = surface.points - middle[0]
    radius = np.linalg.norm(offset - np.outer(offset @ axis, axis), axis=1)
    side = (offset @ axis > 3) & (offset @ axis < 54)
    assert radius[side].mean() == pytest.approx(5.0, abs=0.15)
    assert radius[side].std() < 0.2


@pytest.mark.parametrize(("radius", "smooth"), [(1.5, 0.7), (5.0, 5.0)])
def test_what_smoothing_leaves_nothing_of_is_told_by_its_name(radius, smooth):
    mask = cylinder(radius=radius, shape=(24, 24, 20))
    with pytest.raises(MeshError, match="leaves nothing") as caught:
        surface_of(mask, edge=1.5, smooth=smooth, where="bone_fibula")
    assert "bone_fibula" in str(caught.value)
    assert "--smooth" in caught.value.fix


def test_specks_and_holes_do_not_reach_the_surface():
    mask = cylinder()
    mask.values[2, 2, 5] = True
    mask.values[28:31, 28:31, 9:11] = False
    assert len(bodies(surface_of(mask, edge=2.5))) == 1


def test_surfaces_survive_files(tmp_path):
    surface = surface_of(cylinder(), edge=4.0)
    write_surface(tmp_path / "skin.ply", surface)
    again = read_surface(tmp_path / "skin.ply")
    assert again.is_closed
    assert again.volume == pytest.approx(surface.volume, rel=1e-5)


def test_a_triangle_soup_is_joined_into_a_closed_surface():
    surface = surface_of(cylinder(), edge=4.0)
    soup = Triangles(
        surface.points[surface.faces].reshape(-1, 3),
        np.arange(3 * len(surface.faces)).reshape(-1, 3),
    )
    assert not soup.is_closed
    assert joined(soup).is_closed


def test_triangles_that_a_file_holds_twice_count_once():
    once = surface_of(cylinder(), edge=5.0)
    twice = np.vstack([once.faces, np.roll(once.faces[::2], 1, axis=1)])
    found = joined(Triangles(once.points, twice))
    assert found.is_closed
    assert found.volume == pytest.approx(once.volume)


def test_an_open_surface_is_seen_as_open():
    surface = surface_of(cylinder(), edge=4.0)
    assert not Triangles(surface.points, surface.faces[1:]).is_closed


def test_a_file_that_is_no_surface_is_refused(tmp_path):
    (tmp_path / "skin.stl").write_text("this is no surface")
    with pytest.raises(CaseError, match="surface"):
        read_surface(tmp_path / "skin.stl")
