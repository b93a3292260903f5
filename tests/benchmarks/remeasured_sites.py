"""FEBio's records of the study's sites, measured anew: case folders with noise of their own, and their truth.

    python tests/benchmarks/remeasured_sites.py --out SET [--only h05 h13] [--draw 1] [--with-effect]
    python SHARED/febio-hidden/score.py run --limbcli limbcli --cases SET --out OUT
    python SHARED/febio-hidden/score.py table --cases SET --out OUT

The FEBio study (`febio-hidden` in the reference data) has five sites with nothing hidden, but FEBio's records
without noise of all that are simulated without their effect, too. From each of them a site nNN is made, in
which nothing is hidden (rNN with --with-effect: its record with the effect, where that is in the model), with
the noise that the study states and a seed from the site's number and the draw. Limb, place, channels and
further columns are the site's own; traces are left out. Deeper than the last map of a record, ln speed is
extrapolated linearly. SET/truth.toml has the form of the study's.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tomllib
from pathlib import Path

import numpy as np

from limbcli.measurement.elastography import SweMap, map_file, write_map
from limbcli.model import Array
from limbcli.phantom.case_folder import toml

SHARED = Path(os.environ.get("LIMBCLI_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SITES = SHARED / "febio-hidden"
STEPS, AT_LEAST = (2.0, 1.0, 0.5), 7  # N between levels: the largest that gives so many
HOLD, SITE = 20.0, "p1"  # s
FORCE_N, DEPTH_MM, LEVEL, PIXEL = 0.1, 0.3, 0.05, 0.1  # noise; the last two of speeds
TRAVEL_MM, SKIN_BONE_MM = 0.05, 0.3


def nominal_forces(most: float) -> Array:
    """Forces (n,) N from 0 up to the largest of the record.

    >>> nominal_forces(15.0)
    array([ 0.,  2.,  4.,  6.,  8., 10., 12., 14.])
    >>> len(nominal_forces(10.4)), len(nominal_forces(2.2))
    (11, 5)
    """
    step = next((each for each in STEPS if most / each >= AT_LEAST), STEPS[-1])
    return np.arange(0.0, most + 1e-9, step)


def measured(maps: list[SweMap], rng: np.random.Generator) -> list[SweMap]:
    """With noise common to a level and that of each pixel."""
    found = []
    for each in maps:
        noise = LEVEL * rng.standard_normal() + PIXEL * rng.standard_normal(len(each.speed_m_per_s))
        found.append(SweMap(each.lateral, each.depth, each.speed_m_per_s * np.maximum(1 + noise, 0.3)))
    return found


def level_table(
    columns: list[str], force: Array, depth: Array, maps: list[SweMap], thickness: float,
    rng: np.random.Generator,
) -> dict[str, Array]:  # fmt: skip
    """The columns of the site's table; depth 0 at the first level by definition."""
    read = depth + DEPTH_MM * rng.standard_normal(len(depth)) * (force > 0)
    speeds = [each.speed_m_per_s for each in maps]
    known = {
        "force_n": force + FORCE_N * rng.standard_normal(len(force)),
        "depth_mm": read,
        "hold_s": np.full(len(force), HOLD),
        "swe_mean_m_per_s": np.array([each.mean() for each in speeds]),
        "swe_sd_m_per_s": np.array([each.std() for each in speeds]),
        "swe_pixels": np.array([len(each) for each in speeds]),
        "probe_travel_mm": depth + TRAVEL_MM * rng.standard_normal(len(depth)) * (force > 0),
        "skin_bone_mm": thickness + SKIN_BONE_MM * rng.standard_normal() - read,
    }
    return {name: known[name] for name in columns}


def remeasure(truth: dict, which: str, draw: int, out: Path) -> dict | None:
    """Writes the case folder; its entry in the truth, or None where FEBio's record is not there."""
    from what_maps_keep import at_forces  # the file beside this one

    source, path = SITES / truth["id"], SITES / "exact" / f"{truth['id']}.npz"
    exact = dict(np.load(path)) if path.is_file() else {}
    if f"{SITE}_{which}_map_m_per_s" not in exact:
        return None
    case = tomllib.loads((source / "case.toml").read_text(encoding="utf-8"))
    case["site"] = [each for each in case["site"] if each["name"] == SITE]
    site = case["site"][0]
    site.pop("trace", None)
    table = np.genfromtxt(source / site["levels"], delimiter=",", names=True)
    force = nominal_forces(float(exact[f"{SITE}_{which}_force_n"][-1]))
    depth = np.interp(force, exact[f"{SITE}_{which}_force_n"], exact[f"{SITE}_{which}_depth_mm"])
    number = int(truth["id"][1:])
    rng = np.random.default_rng([number, draw, which == "with"])
    maps = measured(at_forces(exact, which, force), rng)
    columns = level_table(list(table.dtype.names), force, depth, maps, truth["thickness_mm"], rng)
    name = f"{'r' if which == 'with' else 'n'}{number:02d}"
    target = out / name
    (target / SITE).mkdir(parents=True)
    shutil.copytree(source / "surfaces", target / "surfaces")
    case["subject"]["id"] = name
    (target / "case.toml").write_text(toml(case), encoding="utf-8")
    lines = [",".join(columns)] + [
        ",".join(f"{v:.3f}" for v in row) for row in zip(*columns.values(), strict=True)
    ]
    (target / site["levels"]).write_text("\n".join(lines) + "\n", encoding="utf-8")
    if "swe_maps" in site:
        (target / site["swe_maps"]).mkdir()
        for level, each in enumerate(maps):
            write_map(map_file(target / site["swe_maps"], level), each)
    kept = {key: truth[key] for key in ("channels", "thickness_mm", "c_kpa", "m", "fk")}
    hidden = {
        key: truth[key]
        for key in ("effects", "answer", "acceptable", "parameters", "visibility")
        if key in truth
    }
    nothing = {"effects": ["none"], "answer": "none"}
    return {"id": name, **kept, **(hidden if which == "with" else nothing)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--draw", type=int, default=1)
    parser.add_argument("--with-effect", action="store_true")
    options = parser.parse_args()
    truths = tomllib.loads((SITES / "truth.toml").read_text(encoding="utf-8"))["case"]
    which = "with" if options.with_effect else "without"
    made = []
    for truth in truths:
        if options.only is None or truth["id"] in options.only:
            entry = remeasure(truth, which, options.draw, options.out)
            if entry is None:
                print(f"{truth['id']}: no record {which} its effect")
            else:
                made.append(entry)
    (options.out / "truth.toml").write_text(toml({"case": made}), encoding="utf-8")
    print(f"{len(made)} sites in {options.out}")


if __name__ == "__main__":
    main()
