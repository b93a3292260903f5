"""Facets of the sizes asked for, features kept."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing.crop import crop_planes
from limbcli.meshing.domain import BONE, CUT, SKIN, make_domain
from limbcli.meshing.facets import edges_of, faces_round
from limbcli.meshing.frame import site_frame
from limbcli.meshing.improve import FIXED, FREE, NodeConstraints
from limbcli.meshing.mending import mend
from limbcli.meshing.probe import PlacedProbe, ProbeShape, distance_to_faces
from limbcli.meshing.remesh import (
    Boundary,
    Sizes,
    bad_places,
    face_labels,
    lost_bone,
    remesh,
    size_field,
)
from limbcli.meshing.site_mesher import mesh_volume
from limbcli.meshing.surfaces import Triangles
from limbcli.numbers.mesh_bounds import SIZE_MM

PROBE = ProbeShape(40.0, 14.0, 3.0)
PROBES = (PlacedProbe(PROBE),)


@pytest.fixture(scope="module")
def made(leg):
    frame = site_frame(leg, np.array([0.0, 42.0, 0.0]), "transverse", PROBE)
    local = leg.moved(frame.to_model)
    domain = make_domain(local, crop_planes(local, PROBE, 25.0), spacing=1.5)
    fine = domain.boundary
    field = size_field(domain, PROBES, Sizes(3.0, 9.0))
    return domain, fine, field, remesh(fine, domain, field)


def test_whole_numbers_ask_for_the_same_edges(made):
    """`far_size_mm=9` from Python and `--far-size-mm 9`, which is read as 9.0."""
    domain, _, field, _ = made
    whole = size_field(domain, PROBES, Sizes(3, 9))  # type: ignore[arg-type]
    assert (whole.bend.values % 1 > 0.01).any(), "edges between whole lengths are asked for"
    np.testing.assert_array_equal(whole.bend.values, field.bend.values)


@pytest.mark.parametrize("size", [SIZE_MM[0], 1.2, 2.5])
def test_a_small_edge_is_wanted_as_it_was_asked_for(made, size):
    wanted = size_field(made[0], PROBES, Sizes(size, 9.0)).at(np.array([[0.0, 0.0, -1.0]]))
    assert wanted == pytest.approx([size])


def test_probes_on_a_limb_ask_for_the_edges_of_their_sites_models(leg):
    """Edges as in the model of the nearer of two sites: under the probe, beside it and below it."""
    places = ([0.0, 42.0, 0.0], [42.0, 0.0, 20.0])
    frames = [site_frame(leg, np.array(each), "axial", PROBE) for each in places]
    probes = tuple(PlacedProbe(PROBE, each.to_model) for each in frames)
    local = np.array(
        [[0.0, 0.0, 0.0], [5.0, 2.0, -3.0], [0.0, 20.0, -1.0], [30.0, 0.0, -2.0], [0.0, 0.0, -12.0]]
    )
    for each in frames:
        on_limb = local @ each.to_patient[:3, :3].T + each.to_patient[:3, 3]
        wanted = distance_to_faces(PROBES, local)
        np.testing.assert_allclose(distance_to_faces(probes, on_limb), wanted, atol=1e-9)
    assert wanted.max() > 10
    assert np.isinf(distance_to_faces((), local)).all()


def test_volume_is_kept(made):
    _, fine, _, graded = made
    assert graded.surface.volume == pytest.approx(fine.volume, rel=0.01)


def test_surface_is_closed_and_does_not_cross_itself(made):
    graded = made[3]
    edges, _ = edges_of(graded.surface.faces)
    assert len(edges) * 2 == len(graded.surface.faces) * 3
    assert len(bad_places(graded)) == 0


def test_edges_and_faces_round_nodes_are_those_of_a_plain_search(leg, rng):
    """Twin: by loops, on a surface whose nodes and faces are in no order."""
    bone = leg.bones[0]
    n = len(bone.points) + 1  # one node belongs to no face
    faces = rng.permutation(n)[rng.permutation(bone.faces)]
    sides: dict[tuple[int, int], list[int]] = {}
    round_node: list[list[int]] = [[] for _ in range(n)]
    for f, face in enumerate(faces.tolist()):
        for k in range(3):
            ends = sorted((face[k], face[(k + 1) % 3]))
            sides.setdefault((ends[0], ends[1]), []).append(f)
            round_node[face[k]].append(f)
    found = edges_of(faces)
    np.testing.assert_array_equal(found[0], sorted(sides))
    np.testing.assert_array_equal(found[1], [sides[each] for each in sorted(sides)])
    around, start = faces_round(faces, n)
    assert [each.tolist() for each in np.split(around, start[1:-1])] == round_node


def test_a_node_is_held_by_the_labels_that_meet_at_it():
    faces, labels = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [2, 4, 5]]), np.array([CUT, SKIN, BONE, BONE])
    codes = NodeConstraints.of_faces(7, faces, labels).codes.tolist()
    assert codes[0] == [CUT, FREE]
    assert codes[1] == [SKIN, CUT]
    assert codes[2][0] == FIXED
    assert codes[3] == [SKIN, BONE]
    assert codes[4:] == [[BONE, FREE], [BONE, FREE], [FREE, FREE]]


def test_edges_have_the_length_asked_for(made):
    _, _, field, graded = made
    points = graded.surface.points
    edges, _ = edges_of(graded.surface.faces)
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    ratio = length / field.at(points[edges].mean(axis=1))
    assert np.median(ratio) == pytest.approx(1.0, abs=0.12)
    assert np.quantile(ratio, 0.99) < 1.7
    near = PROBE.distance_in_plan(*points[edges].mean(axis=1)[:, :2].T) == 0
    near &= points[edges].mean(axis=1)[:, 2] > -3
    assert np.median(length[near]) == pytest.approx(3.0, rel=0.15)


def test_labels_lie_on_their_surfaces(made):
    domain, _, _, graded = made
    points = graded.surface.points
    for label, field in ((SKIN, domain.skin), (BONE, domain.bone)):
        assert np.abs(field.at(points[np.unique(graded.surface.faces[graded.labels == label])])).max() < 0.2
    for k, plane in enumerate(domain.planes):
        nodes = np.unique(graded.surface.faces[graded.labels == CUT + k])
        assert len(nodes) > 3
        assert np.abs(plane.height(points[nodes])).max() < 1e-3


def test_faces_folded_flat_on_a_neighbour_are_bad():
    """A tetrahedron pressed flat crosses nothing, but its faces lie on each other."""
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    for height, n_bad in ((0.0, 4), (0.2, 0)):
        points = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0], [1, 1, height]])
        assert len(bad_places(Boundary(Triangles(points, faces), np.full(4, SKIN)))) == n_bad


@pytest.mark.slow
def test_a_thin_bone_that_ends_near_the_face_is_kept(make_tube):
    """A bone as wide as its facets collapses from its end; there the edges are made shorter."""
    skin = make_tube((0, 0, -60), (0, 0, 60), (42, 40))
    tibia, fibula = (
        make_tube((-8, 8, -70), (-8, 8, 70), (11, 10)),
        make_tube((10, 22, -70), (10, 22, 5), (4, 4)),
    )
    limb = mend(skin, [tibia, fibula])
    frame = site_frame(limb, np.array([0.0, 42.0, 0.0]), "transverse", PROBE)
    local = limb.moved(frame.to_model)
    domain = make_domain(local, crop_planes(local, PROBE, 25.0), spacing=1.5)
    fine, sizes = domain.boundary, Sizes(5.0, 14.0, bends=8.0, thin=6.0)
    field = size_field(domain, PROBES, sizes)
    as_asked = remesh(fine, domain, field)
    near = field.graded_by_probe(fine.centroids[face_labels(fine, domain) == BONE])
    assert 100 < len(lost_bone(as_asked, fine, field)) < 0.9 * near.sum(), "the tibia is not lost"
    made = mesh_volume(domain, PROBES, sizes)
    kept = Boundary(Triangles(made.points, made.faces), made.labels)
    assert len(lost_bone(kept, fine, field)) == 0


@pytest.mark.slow
def test_a_cleft_between_bones_takes_as_few_facets_as_asked_for(make_tube):
    """Two bones 3 mm apart, one of them 8 mm thick: coarse where that does no harm, and still closed."""
    skin = make_tube((0, 0, -60), (0, 0, 60), (42, 40))
    tibia, fibula = (
        make_tube((0, -8, -70), (0, -8, 70), (11, 10)),
        make_tube((18, -8, -70), (18, -8, 70), (4, 4)),
    )
    limb = mend(skin, [tibia, fibula])
    frame = site_frame(limb, np.array([0.0, 42.0, 0.0]), "transverse", PROBE)
    local = limb.moved(frame.to_model)
    domain = make_domain(local, crop_planes(local, PROBE, 25.0), spacing=1.5)
    fine, found = domain.boundary, []
    for thin in (0.0, 6.0):
        graded = remesh(fine, domain, size_field(domain, PROBES, Sizes(5.0, 14.0, bends=8.0, thin=thin)))
        assert graded.surface.volume == pytest.approx(fine.volume, rel=0.02)
        assert len(bad_places(graded)) == 0
        found.append(len(graded.surface.faces))
    assert found[1] < 0.7 * found[0]
