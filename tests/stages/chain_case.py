"""A small subject whose results are real from `segment` to `build-feb`: a cylinder of fat, muscle and bone.

The series is two files that stand for one: what they hold is made by `anatomy`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from limbcli.case import Case
from limbcli.imaging.dicom import Series
from limbcli.imaging.labels import segmentation_from
from limbcli.imaging.segmentation import Segmentation
from limbcli.imaging.volume import Volume
from limbcli.stages import segment as segment_module
from limbcli.stages.build_feb import build_feb
from limbcli.stages.mesh import MeshRequest, mesh
from limbcli.stages.segment import segment
from tests.stages.coarse_surfaces import coarse_surfaces

CASE = """
format = 1
[subject]
id = "S1"
limb = "left"
[imaging]
mri = "mri"
[probe]
name = "small"
length_mm = 30.0
width_mm = 12.0
edge_radius_mm = 2.0
[model]
margin_mm = 20.0
element = "tet4"
[[site]]
name = "p1"
position_mm = [0.0, 29.5, 0.0]
long_axis = "transverse"
levels = "levels.csv"
trace = "trace.csv"
[site.layers.fat]
thickness_mm = "mri"
[site.noise]
force_n = 0.1
"""
LEVELS = "force_n,depth_mm,swe_mean_m_per_s\n0,0,1.6\n1,1,1.7\n2,2,1.9\n4,3,2.1\n"
SIZES = {"size": 4.0, "far_size": 6.0}


def anatomy() -> Volume:
    """Labels: radius 30 mm, 6 mm of it fat, a bone of 9 mm."""
    n, spacing = 48, 2.0
    half = (n - 1) * spacing / 2
    x, y, _ = np.meshgrid(*3 * [np.linspace(-half, half, n)], indexing="ij")
    radius = np.hypot(x, y)
    values = np.select([np.hypot(x - 4, y) < 9, radius < 24, radius < 30], [2, 1, 4], 0)
    affine = np.diag([spacing, spacing, spacing, 1.0])
    affine[:3, 3] = -half
    return Volume(values.astype(np.uint8), affine)


def imaged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any series shows the anatomy, whose surfaces are coarse."""

    def found(*_: object, **__: object) -> Segmentation:
        return segmentation_from(anatomy())

    def series(*_: object, **__: object) -> Series:
        return Series(anatomy())

    coarse_surfaces(monkeypatch)
    monkeypatch.setattr(segment_module, "segment_limb", found)
    monkeypatch.setattr(segment_module, "read_image", series)


def write_case(folder: Path) -> Case:
    (folder / "mri").mkdir(parents=True)
    for name in ("IM1", "IM2"):
        (folder / "mri" / name).write_bytes(name.encode())
    (folder / "levels.csv").write_text(LEVELS)
    (folder / "trace.csv").write_text("time_s,force_n\n0,0\n1,1\n")
    (folder / "case.toml").write_text(CASE)
    return Case.open(folder)


def make_results(case: Case, out: Path) -> None:
    segment(case, out=out)
    mesh(case, out=out, options=MeshRequest(**SIZES))
    build_feb(case, out=out)
