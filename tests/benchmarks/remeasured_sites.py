"""FEBio's records of the study's sites, measured anew: case folders with noise of their own, and their truth.

    python -m tests.benchmarks.remeasured_sites --out SET [--only h05 h13] [--draw 1] [--hidden study]
    python SHARED/febio-hidden/score.py run --limbcli limbcli --cases SET --out OUT
    python SHARED/febio-hidden/score.py table --cases SET --out OUT

The FEBio study (`febio-hidden` in the reference data) has five sites with nothing hidden, but FEBio's records
without noise of all that are simulated without their effect, too. From each of them a site is made with the
noise that the study states and a seed from the site's number and the draw:

    --hidden nothing      nNN, in which nothing is hidden
    --hidden study        rNN, with what the study hides at this site: of the tissue or the probe by FEBio's
                          record with it, of instruments and operator applied to the record
    --hidden instrument   iNN, with one effect of instruments or operator, it and its size drawn by the seed

Limb, place, channels and further columns are the site's own; traces are left out. Deeper than the last map of
a record, ln speed is extrapolated linearly. SET/truth.toml has the form of the study's.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from limbcli.measurement.elastography import SweMap, map_file, write_map
from limbcli.model import Array
from limbcli.phantom.case_folder import toml
from tests.benchmarks.seeded_rows import NO_RESULT, Row, made, succeeded

if TYPE_CHECKING:
    from tests.benchmarks.instrument_effects import Readings

SHARED = Path(os.environ.get("LIMBCLI_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SITES = SHARED / "febio-hidden"
STEPS, AT_LEAST = (2.0, 1.0, 0.5), 7  # N between levels: the largest that gives so many
HOLD, SITE = 20.0, "p1"  # s
FORCE_N, DEPTH_MM, LEVEL, PIXEL = 0.1, 0.3, 0.05, 0.1  # noise; the last two of speeds
TRAVEL_MM, SKIN_BONE_MM = 0.05, 0.3
PREFIX = {"nothing": "n", "study": "r", "instrument": "i"}


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


def level_table(columns: list[str], exact: Readings, rng: np.random.Generator) -> dict[str, Array]:
    """The columns of the site's table; depth 0 at the first level by definition."""
    pressed = exact.depth != 0
    read = exact.depth + DEPTH_MM * rng.standard_normal(len(exact.depth)) * pressed
    speeds = [each.speed_m_per_s for each in exact.maps]
    known = {
        "force_n": exact.force + FORCE_N * rng.standard_normal(len(exact.force)),
        "depth_mm": read,
        "hold_s": np.full(len(exact.force), HOLD),
        "swe_mean_m_per_s": np.array([each.mean() for each in speeds]),
        "swe_sd_m_per_s": np.array([each.std() for each in speeds]),
        "swe_pixels": np.array([len(each) for each in speeds]),
        "probe_travel_mm": exact.travel + TRAVEL_MM * rng.standard_normal(len(exact.travel)) * pressed,
        "skin_bone_mm": exact.thickness + SKIN_BONE_MM * rng.standard_normal() - read,
    }
    return {name: known[name] for name in columns}


def hidden_in(truth: dict, hidden: str, exact: Readings, rng: np.random.Generator) -> tuple[Readings, dict]:
    """The readings with what is hidden, and what the truth says of it."""
    from tests.benchmarks.instrument_effects import APPLY, drawn

    if hidden == "nothing":
        return exact, {"effects": ["none"], "answer": "none"}
    if hidden == "instrument":
        name, parameters = drawn(exact, "map" in truth["channels"], rng)
        return APPLY[name](exact, parameters), {
            "effects": [name], "answer": name, "parameters": {name: parameters},
        }  # fmt: skip
    if "thickness" in truth["effects"]:
        of_surfaces = 1.0 + truth["parameters"]["thickness"]["epsilon"]
        exact = replace(exact, thickness=exact.thickness * of_surfaces)
    for name in set(APPLY) & set(truth["effects"]):
        exact = APPLY[name](exact, truth["parameters"][name])
    told = ("effects", "answer", "acceptable", "parameters", "visibility")
    return exact, {key: truth[key] for key in told if key in truth}


def remeasure(truth: dict, hidden: str, draw: int, out: Path) -> dict | None:
    """Writes the case folder; its entry in the truth, or None where FEBio's record is not there."""
    from tests.benchmarks.instrument_effects import APPLY, Readings
    from tests.benchmarks.what_maps_keep import at_forces

    in_model = set(truth["effects"]) - set(APPLY) - {"none"}
    if hidden == "study" and truth["effects"] == ["none"]:
        return None
    which = "with" if hidden == "study" and in_model else "without"
    source, path = SITES / truth["id"], SITES / "exact" / f"{truth['id']}.npz"
    known = dict(np.load(path)) if path.is_file() else {}
    if f"{SITE}_{which}_map_m_per_s" not in known:
        return None
    case = tomllib.loads((source / "case.toml").read_text(encoding="utf-8"))
    case["site"] = [each for each in case["site"] if each["name"] == SITE]
    site = case["site"][0]
    site.pop("trace", None)
    table = np.genfromtxt(source / site["levels"], delimiter=",", names=True)
    force = nominal_forces(float(known[f"{SITE}_{which}_force_n"][-1]))
    depth = np.interp(force, known[f"{SITE}_{which}_force_n"], known[f"{SITE}_{which}_depth_mm"])
    exact = Readings(force, depth, depth, truth["thickness_mm"], at_forces(known, which, force))
    number, prefix = int(truth["id"][1:]), PREFIX[hidden]
    rng = np.random.default_rng([number, draw, list(PREFIX).index(hidden)])
    exact, told = hidden_in(truth, hidden, exact, rng)
    maps = measured(exact.maps, rng)
    columns = level_table(list(table.dtype.names), replace(exact, maps=maps), rng)
    name = f"{prefix}{number:02d}"
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
    return {"id": name, **kept, **told}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--draw", type=int, default=1)
    parser.add_argument("--hidden", choices=list(PREFIX), default="nothing")
    options = parser.parse_args()
    truths = tomllib.loads((SITES / "truth.toml").read_text(encoding="utf-8"))["case"]
    options.out.mkdir(parents=True, exist_ok=True)
    chosen = [each for each in truths if options.only is None or each["id"] in options.only]
    jobs = {(each["id"], options.hidden, options.draw): each for each in chosen}

    def one(truth: dict) -> Row:
        entry = remeasure(truth, options.hidden, options.draw, options.out)
        return {NO_RESULT: "no record for this"} if entry is None else {"case": entry}

    rows = made(options.out / "sites.jsonl", jobs, one, key=("site", "hidden", "draw"))
    entries = [row["case"] for row in succeeded(rows)]
    (options.out / "truth.toml").write_text(toml({"case": entries}), encoding="utf-8")
    print(f"{len(entries)} sites in {options.out}")


if __name__ == "__main__":
    main()
