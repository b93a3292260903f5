"""The mesh of a whole limb: what it encloses, what bounds it, which limbs it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.errors import CaseError, MeshError
from limbcli.meshing.limb_parts import limb_frame
from limbcli.meshing.mending import Plane, mend
from limbcli.meshing.quality import dihedral_angles_deg, volumes
from limbcli.meshing.regions import quadratic
from limbcli.meshing.surfaces import Triangles
from limbcli.meshing.whole_limb import (
    LimbMeshOptions,
    _lost_bones,
    check_invariants,
    end_planes,
    least_jacobians,
    limb_mesh,
)
from limbcli.model import Surface
from tests.meshing.stump import stump, turned

pytestmark = pytest.mark.slow
NODES = 14_000


@pytest.fixture(scope="module")
def made():
    surfaces = stump()
    skin = surfaces.pop("skin")
    limb = mend(skin, list(surfaces.values()))
    frame = limb_frame(limb, "left")
    return limb_mesh(limb, surfaces, frame, LimbMeshOptions(nodes=NODES)), surfaces, limb


def all_cells(mesh):
    return np.concatenate([each.cells for each in mesh.solid_blocks])


def test_it_fills_the_skin_without_the_bones(made):
    """The remaining difference is that between facets of some 10 mm and the curved skin."""
    found, surfaces, limb = made
    whole = limb.skin.volume - np.pi * 40**2 * 1.5  # the cut lies 1.5 mm inside the open end
    inside = {
        "bone_tibia": 1.0,
        "bone_fibula": 1.0,
        "bone_patella": 1.0,
        "bone_femur": (158.5 - 114) / (190 - 114),
    }
    bones = sum(share * surfaces[name].volume for name, share in inside.items())
    filled = volumes(found.mesh.points, all_cells(found.mesh)).sum()
    assert filled == pytest.approx(whole - bones, rel=0.015)
    assert filled == pytest.approx(found.expected, rel=0.01)


def test_it_has_about_the_nodes_asked_for_and_good_cells(made):
    mesh = made[0].mesh
    assert len(mesh.points) == pytest.approx(NODES, rel=0.25)
    assert dihedral_angles_deg(mesh.points, all_cells(mesh)).min() > 4.0
    assert least_jacobians(mesh.points, all_cells(mesh)).min() > 0


def test_every_boundary_facet_is_in_one_surface(made):
    mesh = made[0].mesh
    assert set(mesh.surfaces) == {
        "skin", "bone_tibia", "bone_fibula", "bone_femur", "bone_patella", "proximal_cut",
    }  # fmt: skip
    check_invariants(made[0])
    named = np.concatenate([each.facets["tri6"][:, :3] for each in mesh.surfaces.values()])
    assert len(np.unique(np.sort(named, axis=1), axis=0)) == len(named)


def test_a_lost_surface_is_noticed(made):
    from dataclasses import replace

    mesh = made[0].mesh
    surfaces = {name: each for name, each in mesh.surfaces.items() if name != "bone_patella"}
    with pytest.raises(MeshError, match="named facets"):
        check_invariants(replace(made[0], mesh=replace(mesh, surfaces=surfaces)))


def test_no_node_belongs_to_two_bones_and_no_bone_is_held_with_the_cut(made):
    sets = made[0].mesh.node_sets
    nodes = np.concatenate([each for name, each in sets.items() if name.startswith("bone_")])
    assert len(np.unique(nodes)) == len(nodes)
    assert not np.isin(sets["held"], nodes).any()
    assert np.isin(sets["held"], sets["proximal_cut"]).all()


def test_skin_nodes_lie_on_the_round_skin_and_the_cut_is_flat(made):
    mesh = made[0].mesh
    skin = mesh.points[np.unique(mesh.surfaces["skin"].facets["tri6"])]
    middle = skin[(skin[:, 2] > 50) & (skin[:, 2] < 150)]
    assert np.hypot(middle[:, 0], middle[:, 1]) == pytest.approx(40.0, abs=0.6)
    assert np.ptp(mesh.points[mesh.node_sets["proximal_cut"]][:, 2]) < 0.05


def test_facets_are_smaller_where_bone_is_near_the_skin(made):
    """Over the fibula, 17 mm from the axis, against the same heights at the back."""
    mesh = made[0].mesh
    corners = mesh.points[mesh.surfaces["skin"].facets["tri6"][:, :3]]
    surface = Triangles(mesh.points, mesh.surfaces["skin"].facets["tri6"][:, :3])
    _, y, z = corners.mean(axis=1).T
    level = (z > 114) & (z < 130)
    front, back = level & (y < -30), level & (y > 30)  # over the patella 6 mm below the skin, and behind
    assert surface.areas[front].mean() < 0.8 * surface.areas[back].mean()


def test_the_bound_of_the_jacobian_is_one_for_a_straight_cell_and_sees_a_fold():
    points, cells, _ = quadratic(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    assert least_jacobians(points, cells) == pytest.approx([1.0])
    points[4] = points[:2].mean(axis=0) + np.array(
        [0.3, 0.0, 0.0]
    )  # a mid-side node beyond the quarter point
    assert least_jacobians(points, cells)[0] < 0


@pytest.mark.parametrize(("surfaces", "said"), [("tube", "cut at both ends"), ("capsule", "no cut end")])
def test_limbs_without_a_usable_end_are_refused(leg, surfaces, said):
    limb = leg
    if surfaces == "capsule":
        arc = np.linspace(0, np.pi, 17)
        z = np.where(arc < np.pi / 2, 40 * (1 - np.cos(arc)), 120 + 40 - 40 * (1 + np.cos(arc)))
        skin = turned(z[:-1], 40 * np.sin(arc[:-1]), closed_top=True)
        limb = mend(skin, [stump()["bone_tibia"]])
    frame = limb_frame(limb, "left")
    with pytest.raises(CaseError, match=said) as error:
        end_planes(limb, frame, LimbMeshOptions(), where="limb")
    assert error.value.fix


def test_a_limb_cut_at_both_ends_is_taken_if_asked(leg):
    frame = limb_frame(leg, "left")
    planes = end_planes(leg, frame, LimbMeshOptions(distal_cut=True), where="limb")
    assert sorted(planes) == ["distal_cut", "proximal_cut"]
    assert planes["proximal_cut"].normal @ frame.axis > 0.9


@pytest.mark.parametrize("height", [10.0, 190.0])
def test_a_cut_outside_of_the_limb_is_refused(made, height):
    limb = made[2]
    with pytest.raises(CaseError, match="outside of the limb"):
        end_planes(limb, limb_frame(limb, "left"), LimbMeshOptions(cut=height), where="limb")


def test_a_cut_can_be_made_lower(made):
    limb = made[2]
    frame = limb_frame(limb, "left")
    plane = end_planes(limb, frame, LimbMeshOptions(cut=140.0), where="limb")["proximal_cut"]
    assert frame.height(plane.normal[None] * plane.offset)[0] == pytest.approx(140.0, abs=0.1)


def test_a_limb_without_bones_is_refused():
    limb = mend(stump()["skin"], [])
    with pytest.raises(CaseError, match="no bones"):
        limb_mesh(limb, {}, limb_frame(limb, "left"), LimbMeshOptions())


def test_a_limb_in_metres_is_refused():
    skin = stump()["skin"]
    with pytest.raises(MeshError, match=r"encloses 0\.00 cm3") as error:
        mend(Triangles(skin.points / 1e3, skin.faces), [])
    assert "unit" in error.value.fix


def test_a_bone_between_the_cuts_without_facets_is_told(made):
    found, surfaces, _ = made
    assert not [each for each in found.altered if "is not in the mesh" in each]
    kept = {name: each for name, each in found.mesh.surfaces.items() if name != "bone_patella"}
    without = replace(found.mesh, surfaces=kept)
    (told,) = _lost_bones(without, surfaces, found.planes, 36.2)
    assert told.startswith("bone_patella is not in the mesh")
    assert "36 mm" in told
    below_the_patella = {"proximal_cut": Plane(np.array([0.0, 0.0, 1.0]), 110.0)}
    assert _lost_bones(without, surfaces, below_the_patella, 36.2) == []


def test_surfaces_of_a_mesh_are_of_its_cells(made):
    """Each facet is a face of a cell, mid-side nodes included."""
    mesh = made[0].mesh
    cells = all_cells(mesh)
    mids = {}
    for a, b, node in (
        (0, 1, 4), (1, 2, 5), (2, 0, 6), (0, 3, 7), (1, 3, 8), (2, 3, 9),
    ):  # fmt: skip
        for cell in cells:
            mids[frozenset((cell[a], cell[b]))] = cell[node]
    surface: Surface = mesh.surfaces["bone_fibula"]
    for a, b, c, d, e, f in surface.facets["tri6"]:
        assert [mids[frozenset(each)] for each in ((a, b), (b, c), (c, a))] == [d, e, f]
