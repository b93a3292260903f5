"""Skin and fat layers that conform to the surface."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import CaseError
from limbcli.meshing.checks import layers_kept
from limbcli.meshing.conforming_layers import core_of, layers_of, open_ended
from limbcli.meshing.crop import crop_planes
from limbcli.meshing.domain import make_domain
from limbcli.meshing.frame import site_frame
from limbcli.meshing.mending import mend
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.quality import volumes
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model

PROBE = ProbeShape(40.0, 14.0, 3.0)
SKIN, FAT = 1.5, 6.0


@pytest.fixture(scope="module")
def made(leg):
    options = MeshOptions(
        element="tet4", margin=20.0, sizes=Sizes(3.5, 10.0), spacing=1.5, layers=layers_of(skin=SKIN, fat=FAT)
    )
    return site_model(leg, (0.0, 42.0, 0.0), "transverse", PROBE, options)


@pytest.fixture(scope="module")
def made_axial(leg):
    options = MeshOptions(
        element="tet4", margin=14.0, sizes=Sizes(4.0, 10.0), spacing=1.5, layers=layers_of(skin=SKIN, fat=FAT)
    )
    return site_model(leg, (0.0, 42.0, 0.0), "axial", PROBE, options)


def test_layers_have_their_volume(made):
    """A ring of thickness t on a radius of about 40 mm, 54 mm long."""
    mesh = made.model.mesh
    length = 2 * (14 / 2 + 20)
    for name, outside, inside in (("skin", 0.0, SKIN), ("fat", SKIN, SKIN + FAT)):
        exact = np.pi * ((42 - outside) ** 2 - (42 - inside) ** 2) * length
        found = volumes(mesh.points, mesh.block(name).cells).sum()
        assert found == pytest.approx(exact, rel=0.1)  # the limb's mean radius is 40 to 42 mm there


def test_layers_share_their_nodes(made):
    mesh = made.model.mesh
    assert [each.name for each in mesh.solid_blocks] == ["tissue", "fat", "skin"]
    tissue, fat, skin = (np.unique(each.cells) for each in mesh.solid_blocks)
    assert len(np.intersect1d(tissue, fat)) > 100
    assert len(np.intersect1d(fat, skin)) > 100
    assert len(np.intersect1d(tissue, skin)) == 0
    assert (np.isin(mesh.node_sets["skin"], skin)).all()


def test_cells_are_good_and_the_probe_meets_the_skin(made):
    mesh = made.model.mesh
    assert made.quality.inverted_cells == 0
    assert made.quality.min_angle_deg > 4
    contact = np.unique(mesh.surfaces["contact"].facets["tri3"])
    assert mesh.points[contact, 2].max() == pytest.approx(0.0, abs=0.1)


@pytest.mark.slow
def test_layers_reach_into_the_corners_of_four_cuts(made_axial):
    """With cuts on four sides some nodes lie in two of them: they reach the skin along the cuts' edge."""
    mesh = made_axial.model.mesh
    inside = np.unique(np.concatenate([block.cells for block in mesh.solid_blocks]))
    planes = made_axial.domain.planes
    in_cut = np.stack([np.abs(each.height(mesh.points)) < 1e-6 for each in planes])
    corner = np.intersect1d(np.flatnonzero(in_cut.sum(axis=0) == 2), mesh.node_sets["skin"])
    assert len(np.intersect1d(corner, inside)) >= 2
    assert np.abs(made_axial.domain.skin.at(mesh.points[mesh.node_sets["skin"]])).max() < 0.3
    assert made_axial.quality.inverted_cells == 0
    total = sum(volumes(mesh.points, block.cells).sum() for block in mesh.solid_blocks)
    assert total == pytest.approx(made_axial.domain.boundary.volume, rel=0.02), "nothing overlaps"


def test_layers_are_as_thick_at_the_limbs_cut_end_as_in_its_middle(make_tube):
    """Images that end near the site: the lid that closes the skin there is no skin."""
    limb = mend(make_tube((0, 0, -50), (0, 0, 50), (40, 40)), [])
    layers = layers_of(skin=SKIN, fat=FAT)
    domain = make_domain(limb, limb.ends, spacing=2.0)
    below = core_of(open_ended(domain, layers), layers).skin
    middle, end = ([[r, 0.0, z] for r in (0.0, 28.0, 40.0 - SKIN - FAT, 38.0)] for z in (0.0, 48.0))
    assert below.at(np.array(end)) == pytest.approx(below.at(np.array(middle)), abs=0.1)
    assert below.at(np.array(end))[2] == pytest.approx(0.0, abs=0.2)


def test_impossible_thickness_is_refused():
    with pytest.raises(CaseError, match="--fat-mm"):
        layers_of(fat=100.0)


@pytest.mark.slow
@pytest.mark.parametrize(("bone_depth", "least", "centre"), [(25.0, 1.0, 1.0), (9.0, 0.72, 0.72)])
def test_how_much_of_the_layers_is_left_over_bone_is_measured(make_tube, bone_depth, least, centre):
    """60 % of 9 mm are 5.4 mm, of the 7.5 mm that are asked for; 25 mm have room for them."""
    skin = make_tube((0, 0, -90), (0, 0, 90), (42, 42), around=90)
    middle = 42.0 - bone_depth - 10.0
    limb = mend(skin, [make_tube((0, middle, -120), (0, middle, 120), (10, 10))])
    limb = limb.moved(site_frame(limb, np.array([0.0, 42.0, 0.0]), "axial", PROBE).to_model)
    domain = make_domain(limb, crop_planes(limb, PROBE, 20.0), spacing=1.5)
    kept = layers_kept(domain, core_of(domain, layers_of(skin=SKIN, fat=FAT)), PROBE, SKIN + FAT)
    assert kept.centre == pytest.approx(centre, abs=0.03)  # a distance grid of 1.5 mm
    assert kept.least == pytest.approx(least, abs=0.05)
