"""A case folder of one of the limbs of `mesh_sites.py`, with a site that `hidden_sites.py` can measure on.

    python -m tests.benchmarks.openlimb_case --limb 102m --case CASE [--angle-deg 90] [--maps] [--both]
    limbcli segment CASE --out OUT; limbcli mesh CASE --out OUT; limbcli build-feb ...; limbcli run ...
    python -m tests.benchmarks.hidden_sites --case CASE --out OUT --work WORK --max-force-n 26 --size-mm 3.5

Surfaces are written as STL in single precision, as a scanner's software would. The measurement in it is
a placeholder.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from limbcli.meshing.frame import skin_point_at
from limbcli.meshing.surfaces import Triangles

HEAD = """format = 1

[subject]
id = "{name}"
limb = "left"

[imaging]
skin = "surfaces/skin.stl"
bones = [{bones}]

[probe]
name = "GE 9L"
length_mm = 53.0
width_mm = 14.0
edge_radius_mm = 3.0
"""
SITE = """
[[site]]
name = "{name}"
position_mm = [{place}]
long_axis = "{axis}"
levels = "{name}/levels.csv"
trace = "{name}/trace.csv"
{maps}
[site.noise]
force_n = 0.1
depth_mm = 0.3
swe_level_fraction = 0.05
swe_pixel_fraction = 0.10
source = "repeats"
"""
LEVELS = (
    "force_n,depth_mm,swe_mean_m_per_s,swe_sd_m_per_s,swe_pixels\n"
    "0,0,2,0.1,100\n2,2,2.2,0.1,100\n4,4,2.4,0.1,100\n"
)
TRACE = "time_s,force_n\n0,0\n1,2\n"
MAP = "lateral_mm,depth_mm,speed_m_per_s\n0,10,2\n1,10,2\n"


def write_stl(path: Path, surface: Triangles) -> None:
    corners = surface.points[surface.faces].astype("<f4")
    facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    facets["corners"] = corners
    path.write_bytes(b"\0" * 80 + np.uint32(len(corners)).tobytes() + facets.tobytes())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--limb", default="102m")
    parser.add_argument("--case", type=Path, required=True)
    parser.add_argument("--angle-deg", type=float, default=180.0)
    parser.add_argument("--low", action="store_true", help="the lower of the limb's two heights")
    parser.add_argument("--maps", action="store_true")
    parser.add_argument("--both", action="store_true", help="a second orientation at the same place")
    options = parser.parse_args()
    from tests.benchmarks.mesh_sites import limbs

    known, found = [], None
    for name, *limb_and_heights in limbs():
        known.append(name)
        if name == options.limb:
            found = limb_and_heights
            break
    if found is None:
        parser.error(f"there is no limb {options.limb}; known here: {', '.join(known)}")
    limb, heights = found
    folder: Path = options.case
    (folder / "surfaces").mkdir(parents=True)
    write_stl(folder / "surfaces" / "skin.stl", limb.skin)
    bones = [f"surfaces/bone{k}.stl" for k in range(len(limb.bones))]
    for name, bone in zip(bones, limb.bones, strict=True):
        write_stl(folder / name, bone)
    place = skin_point_at(limb, options.angle_deg, heights[0 if options.low else 1])
    text = HEAD.format(name=options.limb, bones=", ".join(f'"{each}"' for each in bones))
    for name, axis in [("p1", "transverse"), ("p2", "axial")][: 2 if options.both else 1]:
        maps = f'swe_maps = "{name}/swe"' if options.maps else ""
        at = ", ".join(f"{x:.2f}" for x in place)
        text += SITE.format(name=name, place=at, axis=axis, maps=maps)
        (folder / name / "swe").mkdir(parents=True)
        (folder / name / "levels.csv").write_text(LEVELS)
        (folder / name / "trace.csv").write_text(TRACE)
        for k in range(3):
            (folder / name / "swe" / f"level_{k:02d}.csv").write_text(MAP)
    (folder / "case.toml").write_text(text)


if __name__ == "__main__":
    main()
