"""The table of places where a site can be, against bodies of known size."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing.facets import divided
from limbcli.meshing.mending import mend
from limbcli.meshing.surfaces import Triangles
from limbcli.stages.segmenting.site_grid import grid_points, write_grid

AROUND = 24


def prism(radius: float, middle: tuple[float, float], longest: float) -> Triangles:
    """A tube from z = 0 to 90 whose triangles span it, divided down to an edge length (mm)."""
    t = 2 * np.pi * np.arange(AROUND) / AROUND
    ring = np.column_stack([middle[0] + radius * np.cos(t), middle[1] + radius * np.sin(t)])
    points = np.vstack([np.insert(ring, 2, z, axis=1) for z in (0.0, 90.0)])
    k = np.arange(AROUND)
    n, j = (k + 1) % AROUND, np.arange(1, AROUND - 1)
    sides = [np.c_[k, n, n + AROUND], np.c_[k, n + AROUND, k + AROUND]]
    ends = [np.c_[0 * j, j + 1, j], np.c_[0 * j, j, j + 1] + AROUND]
    return Triangles(*divided(points, np.vstack([*sides, *ends]), longest))


@pytest.mark.parametrize("longest", [25.0, 6.0])
def test_the_way_to_a_bone_does_not_depend_on_the_size_of_its_triangles(longest: float):
    limb = mend(prism(50.0, (0.0, 0.0), 10.0), [prism(14.0, (0.0, -26.0), longest)])
    in_front = [each.nearest_bone for each in grid_points(limb) if each.angle_deg == 0]
    assert len(in_front) > 2
    np.testing.assert_allclose(in_front, 50.0 - 26.0 - 14.0, atol=0.15)


def test_no_column_has_the_name_of_a_case_key_with_another_meaning(tmp_path):
    """`skin_bone_mm` of a case is along the beam; the table has the distance in any direction."""
    limb = mend(prism(50.0, (0.0, 0.0), 10.0), [prism(14.0, (0.0, -26.0), 25.0)])
    write_grid(tmp_path / "grid.csv", grid_points(limb)[:1])
    header, _ = (tmp_path / "grid.csv").read_text().splitlines()
    assert header.split(",")[-2:] == ["nearest_bone_mm", "position_mm"]
    assert "skin_bone_mm" not in header
