"""Every site meshes: five residual limbs and a whole leg, eight sites each, two resolutions, and thin places.

    python tests/benchmarks/mesh_sites.py [--out FILE] [--limit N] [--size usual|coarse] [--solve tet4|tet10]

One JSON line a site is added to FILE (default: mesh-sites.jsonl in the
temporary folder); what is there is not done again. At the end a table.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from limbcli.errors import LimbError
from limbcli.meshing.frame import skin_point_at
from limbcli.meshing.mending import Limb, mend
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.remesh import Sizes
from limbcli.meshing.site_model import MeshOptions, site_model
from limbcli.meshing.surfaces import Triangles, read_surface
from limbcli.model import LimbModel

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


def thinnest(limb: Limb, low: float, high: float) -> tuple[float, float]:
    """Angle and height, between two heights, where the skin lies closest over bone."""
    from scipy.spatial import cKDTree

    tree = cKDTree(np.concatenate([each.points for each in limb.bones]))
    options = [(a, h) for a in np.arange(0, 360, 15.0) for h in np.linspace(low, high, 5)]
    points = [skin_point_at(limb, a, h) for a, h in options]
    return options[int(np.argmin(tree.query(points)[0]))]


def sites(limb: Limb, heights: tuple[float, float]) -> Iterator[tuple[str, tuple[float, float], str]]:
    """Name, (angle_deg, height) and long axis."""
    for h, axis in zip(heights, ("transverse", "axial"), strict=True):
        for a in ANGLES_DEG:
            yield f"{a:.0f}deg-{h:.0f}mm-{axis}", (a, h), axis
    crest = thinnest(limb, heights[0], heights[1])
    yield "thinnest-transverse", crest, "transverse"
    yield "thinnest-axial", crest, "axial"


def one(
    limb: Limb, place: tuple[float, float], axis: str, sizes: Sizes, *, solve: str | None = None
) -> dict[str, object]:
    start, processor = time.perf_counter(), _processor()
    result: dict[str, object] = {}
    try:
        point = skin_point_at(limb, *place)
        options = MeshOptions(sizes=sizes, element=solve or "tet10")
        found = site_model(limb, tuple(point), axis, PROBE, options)
        result = {"ok": True, "maker": found.maker, "notes": found.notes, **found.quality.to_json()}
        result["thinnest_mm"] = found.checks.thinnest_under_probe_mm
        result["mesh_s"] = round(time.perf_counter() - start, 1)
        if solve:
            result["force_4mm_n"] = force(found.model, found.checks.thinnest_under_probe_mm)
    except LimbError as error:
        result = {"ok": False, "error": error.what}
    result["seconds"] = round(time.perf_counter() - start, 1)
    result["processor_s"] = round(_processor() - processor, 1)
    return result


def force(model: LimbModel, thinnest: float | None) -> float:
    """Probe force (N) at 4 mm, or at half of the tissue over bone where that is less."""
    from limbcli.stages.mesh_study import reference_force

    return reference_force(model, 4.0 if thinnest is None else min(4.0, 0.5 * thinnest))


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
    good = [each for each in lines if each["ok"]]
    print(f"{len(good)} of {len(lines)} succeed")
    for key, worst in (("min_angle_deg", min), ("min_angle_under_probe_deg", min), ("processor_s", max)):
        print(f"  worst {key}: {worst(float(each[key]) for each in good):.2f}")  # type: ignore[arg-type]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "mesh-sites.jsonl")
    parser.add_argument("--limit", type=int, default=10**6)
    parser.add_argument("--size", choices=sorted(RESOLUTIONS), help="only this resolution")
    parser.add_argument("--solve", choices=("tet4", "tet10"), help="also indent by 4 mm, with this element")
    given = parser.parse_args()
    done = [json.loads(each) for each in given.out.read_text().splitlines()] if given.out.is_file() else []
    known = {(each["limb"], each["site"], each["size"]) for each in done}
    every = [
        (k, name, limb, *site)
        for name, limb, heights in limbs()
        for k, site in enumerate(sites(limb, heights))
    ]
    for _, name, limb, site, place, axis in sorted(every, key=lambda each: -each[0]):
        for size, sizes in RESOLUTIONS.items():
            if given.size not in (None, size) or (name, site, size) in known or len(done) >= given.limit:
                continue
            done.append({"limb": name, "site": site, "size": size})
            done[-1] |= one(limb, place, axis, sizes, solve=given.solve)
            with given.out.open("a") as stream:
                stream.write(json.dumps(done[-1]) + "\n")
    table(done)


if __name__ == "__main__":
    main()
