"""Bones in facets keep their volume, however coarse the facets are."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing.bone_volume import with_bone_volume
from limbcli.meshing.crop import crop_planes
from limbcli.meshing.domain import BONE, CLEARANCE, TissueDomain, boundary, make_domain
from limbcli.meshing.mending import mend
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Boundary, Sizes, bad_places, remesh, size_field, unfold
from limbcli.meshing.site_mesher import mesh_volume
from limbcli.meshing.surfaces import Triangles

PROBE = ProbeShape(40.0, 14.0, 3.0)
COARSE = Sizes(5.0, 14.0, bends=8.0, thin=6.0)
RADIUS = 6.0  # mm


@pytest.fixture(scope="module")
def rod(make_tube) -> TissueDomain:
    """A rod along y, 12 mm below the middle of the skin."""
    limb = mend(
        make_tube((0, -60, -40), (0, 60, -40), (40, 40)),
        [make_tube((0, -70, -18), (0, 70, -18), (RADIUS, RADIUS))],
    )
    return make_domain(limb, crop_planes(limb, PROBE, 30.0), spacing=1.0)


def off_bone(points, faces, domain: TissueDomain) -> tuple[np.ndarray, np.ndarray]:
    """Mean distance (mm) of bone's facets from it, and their areas, by points within them."""
    n = 6
    weights = np.array([(i, j, n - 1 - i - j) for i in range(n) for j in range(n - i)]) + 1 / 3
    inside = np.einsum("sk,fkd->fsd", weights / n, points[faces])
    return domain.bone.at(inside.reshape(-1, 3)).reshape(inside.shape[:2]).mean(1), Triangles(
        points, faces
    ).areas


def missing(points, faces, domain: TissueDomain) -> float:
    """Share of the rod's volume that its facets leave out."""
    off, areas = off_bone(points, faces, domain)
    return float(-(off * areas).sum() / (areas.sum() * RADIUS / 2))


@pytest.fixture(scope="module")
def graded(rod):
    sizes = size_field(rod, PROBE, COARSE)
    return unfold(remesh(boundary(rod), rod, sizes), rod), sizes


def test_facets_of_a_thin_bone_enclose_its_volume(rod, graded):
    before, sizes = graded
    after, settled = with_bone_volume(before, rod, sizes)
    lost = [
        missing(each.surface.points, each.surface.faces[each.labels == BONE], rod) for each in (before, after)
    ]
    assert lost[0] > 0.15  # what this is about
    assert abs(lost[1]) < 0.03
    on_bone = np.unique(after.surface.faces[after.labels == BONE])
    assert np.abs(settled.bone.at(after.surface.points[on_bone])).max() < 0.1


def test_nothing_else_moves_and_no_facets_cross(rod, graded):
    before, sizes = graded
    after, settled = with_bone_volume(before, rod, sizes)
    others = np.setdiff1d(np.arange(len(before.surface.points)), before.surface.faces[before.labels == BONE])
    assert (after.surface.points[others] == before.surface.points[others]).all()
    assert (after.surface.faces == before.surface.faces).all()
    assert len(bad_places(after)) == 0
    assert (settled.bone.values - settled.skin.values)[settled.bone.values < 0].min() > CLEARANCE - 1.0


def test_tetrahedra_leave_no_more_of_it(rod):
    mesh = mesh_volume(rod, PROBE, COARSE)
    assert abs(missing(mesh.points, mesh.faces[mesh.labels == BONE], rod)) < 0.04


def test_without_bone_all_is_as_it_was(rod, graded):
    before, sizes = graded
    bare = TissueDomain(rod.skin, None, rod.planes, ())
    after, settled = with_bone_volume(Boundary(before.surface, before.labels), bare, sizes)
    assert after.surface is before.surface
    assert settled is bare
