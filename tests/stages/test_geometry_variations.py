"""What of an assumed geometry is varied, and by how much."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from limbcli.case.parts import Imaging, Shape
from limbcli.errors import MeshError
from limbcli.fitting.geometry import rod_in_model
from limbcli.fitting.geometry_variations import (
    USUAL_DEPTH,
    Variation,
    depth_deviation,
    variations,
    varied_mesh,
    with_second_bone,
)
from limbcli.meshing.morph import deeper
from limbcli.meshing.rods import Rod
from limbcli.model import Mesh
from tests.meshing.test_morph import block

ROD = Rod(np.array([0.0, 0.0, -20.0]), np.array([0.0, 1.0, 0.0]), 5.0, -50.0, 50.0, np.array([0.0, 0.0, 1.0]))


def kinds(imaging: Imaging, *, bones: int = 1) -> list[str]:
    return [each.kind for each in variations(imaging, depth=0.3, bones=bones)]


def test_a_limb_in_numbers_and_a_scan_vary_what_each_assumes():
    numbers = kinds(Imaging(shape=Shape(300.0, 1.5, 5.0, 15.0, 14.0)))
    scan = kinds(Imaging(skin=Path("scan.stl"), bone_radius=14.0))
    common = {"radius", "depth", "slope", "side", "second bone"}
    assert set(numbers) == common | {"roundness", "taper"}
    assert set(scan) == common | {"scale"}
    assert "second bone" not in kinds(Imaging(skin=Path("scan.stl"), bone_radius=14.0), bones=2)


def test_a_scan_is_varied_by_the_scale_that_the_case_states():
    for stated, factor in ((0.01, 1.01), (0.1, 1.1)):
        imaging = Imaging(skin=Path("scan.stl"), bone_radius=14.0, skin_scale=stated)
        (scale,) = [each for each in variations(imaging, depth=0.3, bones=1) if each.kind == "scale"]
        assert scale.value == pytest.approx(factor)


def test_depth_is_in_doubt_by_what_a_shared_bone_misses_a_reading_by():
    site = {"skin_bone_mm": 20.0, "made_mm": 20.9}
    assert depth_deviation(0.4, site) == pytest.approx(np.hypot(0.4, 0.9))
    assert depth_deviation(0.0, {**site, "made_mm": None}) == USUAL_DEPTH


def test_a_bone_that_sites_share_is_put_deeper_below_each_of_them():
    """It was put deeper below the first one, which below another is aside."""
    bone = {"centre_mm": [0, 0, 0], "axis": [0, 0, 1], "radius_mm": 9, "towards": [0, -1, 0],
            "from_mm": -50, "to_mm": 50}  # fmt: skip
    geometry = {"bones": {"bone_1": bone}, "sites": {name: {"bone": "bone_1"} for name in ("front", "left")}}
    for name, out in (("front", [0.0, -1.0, 0.0]), ("left", [1.0, 0.0, 0.0])):
        patient_from_model = np.eye(4)
        patient_from_model[:3, :3] = np.column_stack([[0.0, 0.0, 1.0], np.cross(out, [0.0, 0.0, 1.0]), out])
        patient_from_model[:3, 3] = 30.0 * np.array(out)
        rod = rod_in_model(geometry, name, patient_from_model)
        deep = replace(rod, centre=rod.centre + deeper(rod.centre, rod, 0.3))
        depths = [each.depth_under(np.zeros(3), np.array([0.0, 0.0, -1.0])) for each in (rod, deep)]
        assert depths == pytest.approx([21.0, 21.3])


@pytest.mark.parametrize(("kind", "value"), [("slope", 0.1), ("side", 0.3), ("depth", 0.5)])
def test_another_bone_stays_where_it_is(kind, value):
    mesh = block()
    bone = mesh.node_sets["bone"]
    other = replaced(mesh, np.r_[bone, np.flatnonzero(np.hypot(mesh.points[:, 0], mesh.points[:, 2]) < 1.0)])
    moved = varied_mesh(other, ROD, Variation(kind, value, "")).points - mesh.points
    away = np.hypot(mesh.points[:, 0] - ROD.centre[0], mesh.points[:, 2] - ROD.centre[2])
    far = np.isin(np.arange(len(moved)), other.node_sets["bone"]) & (np.abs(away - 5.0) > 2.5)
    assert far.any()
    assert np.all(moved[far] == 0.0)


def replaced(mesh: Mesh, bone: np.ndarray) -> Mesh:
    return Mesh(mesh.points, mesh.blocks, {**mesh.node_sets, "bone": bone})


def wide() -> Mesh:
    """The block stretched to 80 mm across."""
    mesh = block("tet10")
    sets = {**mesh.node_sets, "fixed": mesh.node_sets["bone"]}
    return Mesh(mesh.points * [4.0, 1.0, 1.0], mesh.blocks, sets)


def test_a_second_bone_is_held_beside_the_first():
    mesh, rod = wide(), Rod(ROD.centre + np.array([0.0, 0.0, 10.0]), ROD.axis, 3.5, -50.0, 50.0, ROD.towards)
    before, after = mesh.node_sets["fixed"], with_second_bone(mesh, rod).node_sets["fixed"]
    held = mesh.points[np.setdiff1d(after, before)]
    assert len(held) >= 6
    assert np.all(np.sign(held[:, 0]) == np.sign(held[0, 0]))  # on one side
    np.testing.assert_allclose(np.abs(held[:, 0]), 20.55, atol=1.05)  # 3.5 + 16 + 1.05, of radius 1.05
    np.testing.assert_allclose(held[:, 2], -10.0, atol=1.05)
    assert set(before) < set(after)
    with pytest.raises(MeshError, match="a second bone next to the first would contain 0 nodes"):
        with_second_bone(block_with_fixed(), ROD)


def block_with_fixed() -> Mesh:
    mesh = block()
    return Mesh(mesh.points, mesh.blocks, {**mesh.node_sets, "fixed": mesh.node_sets["bone"]})
