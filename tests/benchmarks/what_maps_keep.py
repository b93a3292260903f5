"""What of a hidden effect the diagnosis' parts of a map keep, as a table.

    python -m tests.benchmarks.what_maps_keep

For every site of the FEBio study in the reference data (`febio-hidden`) that has maps with and without its
hidden effect, both free of noise: chi2 of their difference at the forces of its levels, each mean aside,

    pixels   in all pixels, each 10 % uncertain and independent;
    parts    in parts of about 4 mm, with the pixels' noise as it is estimated from the site's maps;
    model    the same with the model's own error in maps added, half of the largest: what most sites have.

No simulation is made. A reduction that loses more than half of the first is a fault; the third says how much
can be told with our models.
"""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from limbcli.diagnosis.data.noise_parts import MapNoise
from limbcli.diagnosis.data.rows import SiteRows
from limbcli.diagnosis.data.windows import Windows
from limbcli.measurement.elastography import SweMap, read_maps
from limbcli.measurement.map_noise import pixel_noise
from limbcli.model import Array

SHARED = Path(os.environ.get("LIMBCLI_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SITES = SHARED / "febio-hidden"
PIXEL, SHARE = 0.1, 0.5


@dataclass(frozen=True)
class Kept:
    """chi2 of one site's hidden effect."""

    site: str
    effect: str
    pixels: float
    parts: float
    model: float


def at_forces(exact: dict[str, Array], which: str, force: Array) -> list[SweMap]:
    """Maps of a record free of noise at these forces (n,) N; deeper than its last map on by a line, as the
    readings do."""
    depth = np.interp(force, exact[f"p1_{which}_force_n"], exact[f"p1_{which}_depth_mm"])
    table, known = np.log(exact[f"p1_{which}_map_m_per_s"]), exact[f"p1_{which}_map_depth_mm"]
    x, z = (each.ravel() for each in np.meshgrid(exact["lateral_mm"], exact["below_face_mm"], indexing="ij"))
    found = []
    for d in depth:
        k = int(np.clip(np.searchsorted(known, d) - 1, 0, len(known) - 2))
        share = max((d - known[k]) / (known[k + 1] - known[k]), 0.0)
        speed = np.exp((1 - share) * table[k] + share * table[k + 1]).ravel()
        inside = np.isfinite(speed)
        found.append(SweMap(x[inside], z[inside], speed[inside]))
    return found


def kept(site: str, effect: str, thickness: float) -> Kept | None:
    """None where the records without noise lack maps with or without the effect."""
    path, folder = SITES / "exact" / f"{site}.npz", SITES / site / "p1"
    exact = dict(np.load(path)) if path.is_file() else {}
    both = {"p1_with_map_m_per_s", "p1_without_map_m_per_s"} <= set(exact)
    if not both or not (folder / "swe").is_dir():
        return None
    force = np.genfromtxt(folder / "levels.csv", delimiter=",", names=True)["force_n"]
    measured = read_maps(folder / "swe", len(force))
    with_it, without = (at_forces(exact, which, force) for which in ("with", "without"))
    windows = Windows.of_maps(measured)
    size = (windows.right - windows.left) / windows.across, (windows.bottom - windows.top) / windows.down
    depth = np.interp(force, exact["p1_without_force_n"], exact["p1_without_depth_mm"])
    noise = MapNoise(windows.middles, size, (1.0, 1.0), pixel_noise(measured, usual=PIXEL), depth / thickness)
    raw, rows, apart, counts = 0.0, [], [], []
    for level, (a, b) in enumerate(zip(with_it, without, strict=True)):
        there = {(x, z): v for x, z, v in zip(b.lateral, b.depth, b.speed_m_per_s, strict=True)}
        change = np.array([
            np.log(v / there[x, z]) for x, z, v in zip(a.lateral, a.depth, a.speed_m_per_s, strict=True)
            if (x, z) in there
        ])  # fmt: skip
        raw += float(np.sum((change - change.mean()) ** 2)) / PIXEL**2
        (one, n), (other, _) = windows.log_means(a), windows.log_means(b)
        for part in np.flatnonzero(np.isfinite(one[1:] - other[1:])) + 1:
            rows.append((level, part))
            apart.append(one[part] - other[part])
            counts.append(n[part])
    own = PIXEL / np.sqrt(np.array(counts))
    layout = SiteRows.of("map", *np.array(rows).T)
    pixels = noise.of_pixels(layout, own)
    levels = [np.ones((n, n)) for n in np.bincount(layout.level)]
    mean = block_diag(*levels)  # of a level: not known at all
    found = [
        float(np.array(apart) @ np.linalg.solve(covariance + mean, np.array(apart)))
        for covariance in (pixels, pixels + noise.of_model(layout, SHARE))
    ]
    return Kept(site, effect, raw, *found)


def main() -> None:
    truth = tomllib.loads((SITES / "truth.toml").read_text(encoding="utf-8"))["case"]
    print("| site | hidden | pixels | parts | kept | with the model's error |")
    print("|-|-|-|-|-|-|")
    for case in truth:
        found = kept(case["id"], " + ".join(case["effects"]), float(case["thickness_mm"]))
        if found is not None and found.pixels > 1.0:
            numbers = f"{found.pixels:.0f} | {found.parts:.0f} | {found.parts / found.pixels:.2f}"
            print(f"| {found.site} | {found.effect} | {numbers} | {found.model:.0f} |")


if __name__ == "__main__":
    main()
