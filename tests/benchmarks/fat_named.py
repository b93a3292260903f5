"""What `diagnose` says of fat on real indentations, with and without the layers as a channel; resumable.

    python -m tests.benchmarks.fat_named --work DIR [--locations LL_A LL_P] [--per-band 4] [--seed 7]

Reads ../shared/data/multis/indentations.csv (or LIMBCLI_SHARED). Rows are drawn by seed, the same number of
each band of fat thickness. A row becomes a case as a user would write it: `[imaging] shape` with the row's
layers, a levels.csv of three levels (first contact; half the depth, where the parabola through the table's
slope and the largest force has its force; the largest force), the noise that the table itself tells. The
table has no circumference, no second dimension of the face and no wave speed: a usual circumference of the
place, a face four times as long as wide, and no speeds are taken. Every answer is one line of
<work>/fat-named.jsonl.
"""

from __future__ import annotations

import argparse
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case
from limbcli.cohorts.column_checks import checked_cohort
from limbcli.cohorts.estimate import CohortNoise, noise_of
from limbcli.cohorts.table import CohortTable
from limbcli.errors import LimbError, MeasurementError
from limbcli.errors.problems import checked
from limbcli.stages.diagnose import DiagnoseOptions, diagnose
from limbcli.stages.segment import segment
from tests.benchmarks.cohort import LEG, shared_table
from tests.benchmarks.seeded_rows import made

BANDS = ((0.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 15.0), (15.0, np.inf))  # mm of fat
AROUND = {"LL": 360.0, "UL": 540.0, "LA": 250.0, "UA": 300.0}  # mm, usual circumferences of adults
BONE = {"LL": 14.0, "UL": 14.0, "LA": 8.0, "UA": 11.0}  # mm
_SLENDER, _EDGE = 4.0, 2.0  # length over width of the face; mm
_FORCE_NOISE = 0.02  # of the largest force
_ROOM = 1.1  # of the least circumference that holds layers and bone
FAT = "adipose-layer"
_LIKELY = 0.5  # probability of fat from which it is counted as likely

CASE = """format = 1
[subject]
id = "R{line}"
limb = "left"
[imaging]
shape = {{ circumference_mm = {around:.0f}, skin_mm = {skin:.4f}, fat_mm = {fat:.4f}, \
muscle_mm = {muscle:.4f}, bone_radius_mm = {bone:g} }}
[probe]
length_mm = {length:.1f}
width_mm = {width:.1f}
edge_radius_mm = {edge:g}
[[site]]
name = "p1"
long_axis = "transverse"
levels = "levels.csv"
[site.noise]
force_n = {force_noise:.4f}
depth_mm = {depth_noise:.4f}
layer_mm = {layer_noise:.4f}
source = "repeats"
"""


def middle_force(force: float, face: float, depth: float, slope: float) -> float:
    """N at half the depth, of the parabola through first contact and the largest force.

    p = a d + b d^2; the least-squares line through first contact over even depths has slope a + 3/4 b D.
    """
    return 0.5 * depth * face * (2.0 * slope - force / face / depth)


def usable(table: CohortTable) -> np.ndarray:
    """Rows whose layers all shorten, and whose parabola rises from first contact on."""
    middle = middle_force(table.force, table.face, table.depth, table.slope)
    rises = (middle > 0.05 * table.force) & (middle < 0.95 * table.force)
    return rises & (table.shortened > 0).all(axis=1) & (table.thickness > 0.5).all(axis=1)


def drawn(table: CohortTable, locations: tuple[str, ...], per_band: int, seed: int) -> list[int]:
    """Row numbers, `per_band` of every band of fat thickness where there are as many."""
    rng = np.random.default_rng(seed)
    fits = usable(table) & np.isin(table.site.astype(str), locations)
    fat, found = table.thickness[:, 1], []
    for low, high in BANDS:
        here = np.flatnonzero(fits & (fat >= low) & (fat < high))
        found += sorted(rng.permutation(here)[:per_band].tolist())
    return found


def write_case(folder: Path, table: CohortTable, k: int, noise: CohortNoise, *, layers: bool) -> Case:
    """Row k as a case; layers : whether levels.csv has them under load."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    limb = str(table.site[k])[:2]
    skin, fat, muscle = table.thickness[k]
    width = np.sqrt(table.face[k] / _SLENDER)
    least = np.pi * (table.whole[k] + 2 * BONE[limb] + 2.0)
    edges = noise.layers.shortened
    text = CASE.format(
        line=int(table.lines[k]), around=max(AROUND[limb], _ROOM * least), skin=skin, fat=fat, muscle=muscle,
        bone=BONE[limb], length=_SLENDER * width, width=width, edge=_EDGE,
        force_noise=_FORCE_NOISE * table.force[k], depth_noise=float(edges.max()),
        layer_noise=float(edges[1] / np.sqrt(2.0)),
    )  # fmt: skip
    (folder / "case.toml").write_text(text)
    depth, force = float(table.depth[k]), float(table.force[k])
    middle = middle_force(force, float(table.face[k]), depth, float(table.slope[k]))
    rows = [[0.0, 0.0], [middle, depth / 2], [force, depth]]
    lines = [",".join(f"{each:.6g}" for each in row) for row in rows]
    header = "force_n,depth_mm"
    if layers:
        header += ",skin_mm,fat_mm,muscle_mm"
        ends = [table.thickness[k], None, table.thickness[k] - table.shortened[k]]
        lines = [
            line + ("," + ",".join(f"{x:.6g}" for x in end) if end is not None else ",,,")
            for line, end in zip(lines, ends, strict=True)
        ]
    (folder / "levels.csv").write_text("\n".join([header, *lines]) + "\n")
    return Case.open(folder)


def one(table: CohortTable, k: int, noise: CohortNoise, layers: bool, work: Path) -> dict[str, Any]:
    """Diagnose one row as a user would."""
    name = f"{int(table.lines[k])}-{'with' if layers else 'without'}"
    row: dict[str, Any] = {
        "line": int(table.lines[k]), "location": str(table.site[k]), "layers": layers,
        "fat_mm": round(float(table.thickness[k, 1]), 2),
        "strain": round(float(table.depth[k] / table.whole[k]), 3),
    }  # fmt: skip
    clock = time.process_time()
    try:
        case, out = write_case(work / "cases" / name, table, k, noise, layers=layers), work / "out" / name
        segment(case, out=out)
        found = diagnose(case, out=out, options=DiagnoseOptions())[0].data
    except LimbError as error:
        return row | {"failed": str(error).splitlines()[0]}
    p = {each["name"]: each["probability"] for each in found["candidates"]}
    sets = [sorted(each) for each in found["confidence_set"]]
    return row | {
        "verdict": found["verdict"], "set": sets, "p_fat": p.get(FAT), "added": found["shrink"][-1]["values"],
        "chi2_per_nu": [found["shrink"][0]["chi2_per_nu"], found["shrink"][-1]["chi2_per_nu"]],
        "hidden_effects_not_seen": [each["name"] for each in found["blind_spots"]],
        "channels": found["channels"], "processor_s": round(time.process_time() - clock, 1),
    }  # fmt: skip


def show(rows: list[dict[str, Any]]) -> None:
    """By fat thickness: what was said with and without layers."""
    print(
        "\n| fat | rows | layers | untestable | adequate | something missing | of it fat in the set "
        "| fat named | fat's probability above 0.5 | failed |\n|-|-|-|-|-|-|-|-|-|-|"
    )
    for low, high in BANDS:
        for layers in (False, True):
            mine = [r for r in rows if low <= r["fat_mm"] < high and r["layers"] is layers]
            tested = [r for r in mine if "verdict" in r]
            verdicts = [r["verdict"] for r in tested]
            with_fat = [r for r in tested if any(FAT in each for each in r["set"])]
            counts = (
                verdicts.count("untestable"), verdicts.count("adequate"),
                sum(each in ("named", "ambiguous", "unexplained") for each in verdicts), len(with_fat),
                sum(r["verdict"] == "named" for r in with_fat),
                sum((r["p_fat"] or 0.0) > _LIKELY for r in tested), len(mine) - len(tested),
            )  # fmt: skip
            if mine:
                band = f"{low:g} to {high:g} mm" if np.isfinite(high) else f"{low:g} mm and more"
                cells = " | ".join(map(str, counts))
                print(f"| {band} | {len(mine)} | {'with' if layers else 'without'} | {cells} |")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--table", type=Path, default=None)
    parser.add_argument("--locations", nargs="+", default=list(LEG))
    parser.add_argument("--per-band", type=int, default=4)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    table_file = given.table or shared_table()
    if not table_file.is_file():
        raise SystemExit(f"there is no {table_file}: set LIMBCLI_SHARED, or name a --table")
    table = checked(*checked_cohort(table_file), MeasurementError)
    noise = noise_of(table)
    given.work.mkdir(parents=True, exist_ok=True)
    store = given.work / "fat-named.jsonl"
    chosen = drawn(table, tuple(given.locations), given.per_band, given.seed)
    fits = usable(table) & np.isin(table.site.astype(str), given.locations)
    print(
        f"{len(chosen)} of {int(fits.sum())} rows whose curve is a rising parabola and whose layers shorten"
    )
    jobs = {(int(table.lines[k]), layers): (k, layers) for k in chosen for layers in (True, False)}

    def of_row(job: tuple[int, bool]) -> dict[str, Any]:
        return one(table, job[0], noise, job[1], given.work)

    show(made(store, jobs, of_row, key=("line", "layers")))


if __name__ == "__main__":
    main()
