"""Every site meshes: five residual limbs and a whole leg, eight sites each, two resolutions, and thin places.

    python -m tests.benchmarks.mesh_sites [--out FILE] [--limit N] [--size usual|coarse] [--solve tet4|tet10]

Beside the eight (four around at two heights) the place where the skin lies closest over bone (the
tibial crest, mostly) and the fibular head. One JSON line a site is added to FILE (default:
mesh-sites.jsonl in the temporary folder); what is there is not done again. At the end a table, and
the exit code 1 if a site fails or a mesh is not what it must be (see `faults`).
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from limbcli.errors import LimbError
from limbcli.meshing.frame import skin_point_at
from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_mesher import MIN_ANGLE_DEG, MIN_ANGLE_UNDER_PROBE_DEG
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.meshing.surfaces import Triangles, read_surface
from limbcli.model import Array, LimbModel
from tests.benchmarks.seeded_rows import made

SHARED = Path(os.environ.get("LIMBCLI_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "data"
TIBIA = 380.0  # mm: OpenLimb's lengths are in units of the intact tibia
ANGLES_DEG = (0.0, 90.0, 180.0, 270.0)
RESOLUTIONS = {"usual": Sizes(), "coarse": Sizes(under_probe=4.0, far=10.0)}
PROBE = ProbeShape(53.0, 14.0, 3.0)


def limbs() -> Iterator[tuple[str, Limb, tuple[float, float]]]:
    """Name, mended limb in mm, and two heights (mm above its distal end)."""
    for path in sorted((SHARED / "openlimb").glob("*.stl")):
        raw = read_surface(path)
        limb = mend(Triangles(raw.points * TIBIA, raw.faces), [])
        length = -limb.skin.points[:, 2].min()
        yield path.stem, limb, (0.35 * length, 0.8 * length)
    folder = SHARED / "visible-human-leg"
    bones = [read_surface(folder / f"VHF_right_{b}.obj") for b in ("tibia", "fibula", "femur", "patella")]
    limb = mend(read_surface(folder / "VHF_right_skin_leg_5p0_mm.obj"), bones)
    yield "visible-human", limb, (165.0, 310.0)


def thinnest(limb: Limb, low: float, high: float) -> Array:
    """The skin point (3,), between two heights, closest over bone."""
    from scipy.spatial import cKDTree

    tree = cKDTree(np.concatenate([each.points for each in limb.bones]))
    places = [(a, h) for a in np.arange(0, 360, 15.0) for h in np.linspace(low, high, 5)]
    points = np.array([skin_point_at(limb, a, h) for a, h in places])
    return points[int(np.argmin(tree.query(points)[0]))]


def fibular_head(limb: Limb) -> Array:
    """The skin point (3,) closest to the topmost 12 mm of the fibula: the slender one of the small bones."""
    from scipy.spatial import cKDTree

    def slenderness(bone: Triangles) -> float:
        x, y, z = np.ptp(bone.points, axis=0)
        return float(z / max(x, y))

    small = [each for each in limb.bones if each.volume < 60e3]
    fibula = max(small, key=slenderness).points
    head = fibula[fibula[:, 2] > fibula[:, 2].max() - 12.0]
    distance, _ = cKDTree(head).query(limb.skin.points)
    return np.asarray(limb.skin.points[int(np.argmin(distance))])


def sites(limb: Limb, heights: tuple[float, float]) -> Iterator[tuple[str, Array, str]]:
    """Name, skin point (3,) and long axis."""
    for h, axis in zip(heights, ("transverse", "axial"), strict=True):
        for a in ANGLES_DEG:
            yield f"{a:.0f}deg-{h:.0f}mm-{axis}", skin_point_at(limb, a, h), axis
    crest, head = thinnest(limb, heights[0], heights[1]), fibular_head(limb)
    for axis in ("transverse", "axial"):
        yield f"thinnest-{axis}", crest, axis
    for axis in ("transverse", "axial"):
        yield f"fibular-head-{axis}", head, axis


def one(limb: Limb, point: Array, axis: str, sizes: Sizes, *, solve: str | None = None) -> dict[str, object]:
    start, processor = time.perf_counter(), _processor()
    result: dict[str, object] = {"ok": False}
    try:
        options = MeshOptions(sizes=sizes, element=solve or "tet10")
        found = site_model(limb, (point[0], point[1], point[2]), axis, PROBE, options)
        result |= {"maker": found.maker, "notes": found.notes, **vars(found.quality)}
        result["thinnest_mm"] = found.checks.thinnest_under_probe_mm
        result["mesh_s"] = round(time.perf_counter() - start, 1)
        result["mesh_processor_s"] = round(_processor() - processor, 1)
        if solve:
            result["force_4mm_n"] = force(found.model, found.checks.thinnest_under_probe_mm)
        result["ok"] = True
    except LimbError as error:
        result["error"] = error.what
    result["seconds"] = round(time.perf_counter() - start, 1)
    result["processor_s"] = round(_processor() - processor, 1)
    return result


def force(model: LimbModel, thinnest: float | None) -> float:
    """Probe force (N) at 4 mm, or at half of the tissue over bone where that is less."""
    from limbcli.site_model.mesh_study import reference_force

    return reference_force(model, 4.0 if thinnest is None else min(4.0, 0.5 * thinnest))


def faults(line: dict[str, object]) -> list[str]:
    """What a finished site lacks: angles under the probe and elsewhere, Jacobians, a force asked for."""
    if "min_angle_deg" not in line:
        return ["no mesh"]
    least = {"min_angle_under_probe_deg": MIN_ANGLE_UNDER_PROBE_DEG, "min_angle_deg": MIN_ANGLE_DEG}
    out = [f"{key} {line[key]:.1f}" for key, least_deg in least.items() if float(line[key]) < least_deg]  # type: ignore[arg-type]
    if line["inverted_cells"]:
        out.append(f"{line['inverted_cells']} inverted cells")
    return out if line["ok"] else [*out, "not solved"]


def _processor() -> float:
    own, children = (resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def table(lines: list[dict[str, object]]) -> None:
    columns = (
        "n_cells",
        "min_angle_deg",
        "min_angle_under_probe_deg",
        "min_scaled_jacobian",
        "processor_s",
        "seconds",
    )
    print(f"{'limb':16}{'site':28}{'size':8}{'ok':4}{'by':9}" + "".join(f"{c[:16]:>18}" for c in columns))
    for each in lines:
        figures = "".join(f"{float(each.get(c) or 0):18.2f}" for c in columns)  # type: ignore[arg-type]
        maker = str(each.get("maker", "-"))
        print(
            f"{each['limb']:16}{each['site']:28}{each['size']:8}{'yes' if each['ok'] else 'NO':4}{maker:9}"
            + figures
        )
    for each in lines:
        if faults(each):
            lacks = "; ".join([*faults(each), str(each.get("error", ""))])
            print(f"{each['limb']} {each['site']} {each['size']}: {lacks}")
    good = [each for each in lines if not faults(each)]
    print(f"{len(good)} of {len(lines)} succeed")
    keys = ("min_angle_deg", "min_angle_under_probe_deg", "min_scaled_jacobian", "processor_s", "seconds")
    for key in keys if good else ():
        values = [float(each[key]) for each in good]  # type: ignore[arg-type]
        print(f"  {key}: {min(values):.2f} to {max(values):.2f}, median {np.median(values):.2f}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "mesh-sites.jsonl")
    parser.add_argument("--limit", type=int, default=10**6)
    parser.add_argument("--size", choices=sorted(RESOLUTIONS), help="only this resolution")
    parser.add_argument("--solve", choices=("tet4", "tet10"), help="also indent by 4 mm, with this element")
    given = parser.parse_args()
    every = [
        (k, name, limb, *site)
        for name, limb, heights in limbs()
        for k, site in enumerate(sites(limb, heights))
    ]
    jobs = {
        (name, site, size): (limb, point, axis, sizes)
        for _, name, limb, site, point, axis in sorted(every, key=lambda each: -each[0])
        for size, sizes in RESOLUTIONS.items()
        if given.size in (None, size)
    }
    jobs = dict(islice(jobs.items(), given.limit))
    done = made(
        given.out, jobs, lambda job: one(*job, solve=given.solve), key=("limb", "site", "size"), show=None
    )
    table(done)
    return int(any(map(faults, done)))


if __name__ == "__main__":
    sys.exit(main())
