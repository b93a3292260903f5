"""A site's complete model on a limb of known shape."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.quality import volumes
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, SiteModel, site_model

PROBE = ProbeShape(40.0, 14.0, 3.0)
OPTIONS = MeshOptions(margin=25.0, sizes=Sizes(3.5, 10.0), spacing=1.5)


@pytest.fixture(scope="module")
def made(leg) -> SiteModel:
    return site_model(leg, (0.0, 42.0, 0.0), "transverse", PROBE, OPTIONS)


def test_volume_is_limb_less_bones(made):
    """64 mm along the limb, seen from the skin's normal (tilted by its taper), less two tapered bones."""
    tilt = np.arctan2(45 - 35, 200)
    z = np.linspace(-32, 32, 1001) / np.cos(tilt) + 40 * np.sin(tilt)

    def polygon(sides: int) -> float:
        return sides / 2 * np.sin(2 * np.pi / sides)

    limb = polygon(40) * (40 + 0.05 * z) ** 2
    bones = polygon(40) * (11 + z / 120) ** 2 + polygon(24) * (5.5 + 0.5 * z / 120) ** 2
    exact = np.trapezoid(limb - bones, z)
    mesh = made.model.mesh
    assert volumes(mesh.points, mesh.block("tissue").cells).sum() == pytest.approx(exact, rel=0.01)


def test_cells_are_good(made):
    assert made.quality.inverted_cells == 0
    assert made.quality.min_angle_under_probe_deg >= 8
    assert made.quality.min_angle_deg >= 4
    assert made.quality.min_scaled_jacobian > 0


def test_nodes_lie_on_their_surfaces(made):
    mesh, domain = made.model.mesh, made.domain
    skin = np.unique(mesh.surfaces["skin"].facets["tri6"][:, :3])
    bone = np.unique(mesh.surfaces["bone"].facets["tri6"][:, :3])
    assert np.abs(domain.skin.at(mesh.points[skin])).max() < 0.1
    assert np.abs(domain.bone.at(mesh.points[bone])).max() < 0.2  # at the rim with a cut; else 0.01
    cut = mesh.points[np.unique(mesh.surfaces["cut"].facets["tri6"])]
    assert np.abs(np.abs(cut[:, 1]) - 32).max() < 1e-6


def test_sets_and_surfaces_carry_their_names(made):
    mesh = made.model.mesh
    assert [each.name for each in mesh.blocks] == ["tissue", "probe", "probe_tips"]
    assert {"bone", "cut", "fixed", "skin"} <= set(mesh.node_sets)
    assert {"skin", "contact", "bone", "cut", "probe_face"} <= set(mesh.surfaces)
    joined = np.union1d(mesh.node_sets["bone"], mesh.node_sets["cut"])
    assert (mesh.node_sets["fixed"] == joined).all()
    contact = mesh.points[np.unique(mesh.surfaces["contact"].facets["tri6"])]
    assert np.abs(contact[:, 0]).max() < 40
    assert contact[:, 2].max() <= 0.05


def test_facets_point_out_of_the_tissue(made):
    mesh = made.model.mesh
    middle = mesh.points[mesh.block("tissue").cells[:, :4]].mean(axis=(0, 1))
    f = mesh.surfaces["skin"].facets["tri6"]
    a, b, c = (mesh.points[f[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    axis = np.array([0.0, 1.0, 0.0])  # the limb's, in the frame of a transverse probe
    radial = (a - middle) - np.outer((a - middle) @ axis, axis)
    assert (np.einsum("ij,ij->i", normal, radial) > 0).all()
    assert mesh.points[f[:, 3]] == pytest.approx((a + b) / 2)


def test_every_node_is_used_once(made):
    mesh = made.model.mesh
    used = np.unique(np.concatenate([each.cells.ravel() for each in mesh.blocks]))
    assert len(used) == len(mesh.points)
    assert len(np.unique(mesh.points.round(9), axis=0)) == len(mesh.points)


def test_probe_starts_a_little_inside(made):
    mesh, body = made.model.mesh, made.model.bodies[0]
    face = mesh.points[np.unique(mesh.block("probe").cells)]
    assert face[:, 2].min() == pytest.approx(-OPTIONS.start_depth)
    assert body.center_of_mass == (0.0, 0.0, -OPTIONS.start_depth)
    contact = mesh.points[np.unique(mesh.surfaces["contact"].facets["tri6"])]
    assert contact[:, 2].max() > -0.15  # the skin is there at first touch


def test_checks_measure_the_limb(made):
    # The fibula's top lies 7.5 mm above the axis at x = -18, the skin there at sqrt(40^2 - 18^2).
    assert made.checks.over_tissue_share == 1.0
    assert made.checks.to_cut_mm == pytest.approx(25.0, abs=1e-6)
    assert 0 < made.checks.bone_share < 1
    assert made.checks.thinnest_under_probe_mm == pytest.approx(np.sqrt(40**2 - 18**2) - 7.5, abs=1.0)


@pytest.mark.slow
def test_tet4_has_the_corners_of_tet10(leg, made):
    linear = site_model(
        leg,
        (0.0, 42.0, 0.0),
        "transverse",
        PROBE,
        MeshOptions(element="tet4", margin=25.0, sizes=Sizes(3.5, 10.0), spacing=1.5),
    )
    four, ten = linear.model.mesh.block("tissue").cells, made.model.mesh.block("tissue").cells
    assert four.shape == (len(ten), 4)
    assert (four == ten[:, :4]).all()
    assert "tri3" in linear.model.mesh.surfaces["contact"].facets


def test_unknown_element_is_refused(leg):
    with pytest.raises(CaseError, match="hex8"):
        site_model(leg, (0.0, 42.0, 0.0), "axial", PROBE, MeshOptions(element="hex8"))


@pytest.mark.parametrize(("height", "axis"), [(97.0, "transverse"), (85.0, "axial")])
def test_a_face_that_reaches_beyond_the_images_is_refused(leg, height, axis):
    """The limb ends at 100 mm, the cut lies 1.5 mm inside; half of the face is 7 mm across, 20 mm along."""
    with pytest.raises(CaseError, match="inside the probe's face"):
        site_model(leg, (0.0, 40.0 + 0.05 * height, height), axis, PROBE, OPTIONS)
