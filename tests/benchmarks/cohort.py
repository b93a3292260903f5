"""What 95 real people's indentations say, as tables: the lower leg (LL_A, LL_P), then all eight sites.

    python tests/benchmarks/cohort.py [--out FOLDER] [--table FILE] [--locations LL_A LL_P]

Reads ../shared/data/multis/indentations.csv (or LIMBCLI_SHARED) unless a table is named.
"""

from __future__ import annotations

import argparse
import csv
import os
import tempfile
import time
from pathlib import Path
from typing import Any

from limbcli.stages.cohort import cohort

REPOSITORY = Path(__file__).resolve().parents[2]
LEG = ("LL_A", "LL_P")


def shared_table() -> Path:
    named = os.environ.get("LIMBCLI_SHARED")
    folder = Path(named) if named else REPOSITORY.parent / "shared"
    return folder / "data" / "multis" / "indentations.csv"


def part_of(table: Path, locations: tuple[str, ...], folder: Path) -> Path:
    """The rows of some locations, as a table of its own."""
    if not locations:
        return table
    with table.open(newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        rows = [row for row in reader if row["location"] in locations]
    path = folder / f"{'-'.join(locations)}.csv"
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, reader.fieldnames or [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return path


def show(title: str, data: dict[str, Any], seconds: float) -> None:
    print(f"\n### {title}: {data['n_rows']} rows, {data['n_people']} people, {seconds:.0f} processor s")
    print(
        "\n| site | rows | c muscle kPa | c fat kPa | c fat / c muscle | m | determined by the population (c "
        "muscle, c fat, m) |"
    )
    print("|-|-|-|-|-|-|-|")
    for site, own in data["sites"].items():
        cells = []
        for key in ("c_muscle_kpa", "c_fat_kpa", "m"):
            value = own["population"][key]
            reported = (
                f"{value['geometric_mean']:.3g} ({value['low']:.3g} to {value['high']:.3g}) x/÷ "
                f"{value['spread_factor']:.2f}"
            )
            cells.append(value["beyond_family"] or reported)
        left = ", ".join(
            f"{100 * own['population'][key]['mean_shrinkage']:.0f} %"
            for key in ("c_muscle_kpa", "c_fat_kpa", "m")
        )
        print(
            f"| {site} | {own['n_rows']} | {cells[0]} | {cells[1]} | {own['c_fat_over_c_muscle']:.2g} | "
            f"{cells[2]} | {left} |"
        )
    print(
        "\n| site | one tissue: fat shortens more than it by, noise deviations, median (rows beyond 2) | "
        "fat 2 to 4 mm | 4 to 8 mm | 8 to 15 mm | 15 mm and more |"
    )
    print("|-|-|-|-|-|-|")
    for site, own in data["sites"].items():
        one = own["homogeneous"]
        bands = [
            one["by_fat_thickness"].get(name)
            for name in ("2 to 4 mm", "4 to 8 mm", "8 to 15 mm", "15 mm and more")
        ]
        reported = [
            f"{each['median_noise_deviations']:.1f} ({each['n_rows']})" if each else "–" for each in bands
        ]
        print(
            f"| {site} | {one['median_noise_deviations']:.1f} ({100 * one['share_beyond_2']:.0f} %) | "
            f"{' | '.join(reported)} |"
        )
    found = data["compliance_left_out"]
    print("\n| compliance of people left out, ten folds by person | mean absolute difference, % |")
    print("|-|-|")
    print(
        f"| from thicknesses | {found['mean_absolute_difference_percent']:.1f} (± "
        f"{found['standard_deviation_percent']:.1f}; with other people "
        f"{found['interval_95_percent'][0]:.1f} to {found['interval_95_percent'][1]:.1f}) |"
    )
    worst = found["largest_row"]
    print(
        f"| of it one row ({worst['subject']} {worst['location']}, {worst['difference_percent']:.0f} % "
        f"off) | {worst['share_of_the_mean_percent']:.1f} |"
    )
    if found["with_person_columns"]:
        person = found["with_person_columns"]
        print(f"| with {', '.join(person['columns'])} | {person['mean_absolute_difference_percent']:.1f} |")
    for key, value in found["same_folds"].items():
        print(f"| {key.removesuffix('_percent').replace('_', ' ')}, same folds | {value:.1f} |")
    print(f"| marks and slope alone | {found['repeatability']['percent_from_marks_and_slope_alone']:.1f} |")
    print(
        f"| share of the residual variance that a person's sites have in common | "
        f"{found['person_share_of_residual_variance']} |"
    )
    used = [each["with_slab"] for each in found["chosen"]]
    print(
        f"\nThe slab was chosen in {sum(used)} of {len(used)} folds. By site: "
        + ", ".join(f"{k} {v:.1f}" for k, v in found["by_site_percent"].items())
    )
    noise = {key: round(value, 3) for key, value in data["noise"]["layer_shortened_mm"].items()}
    print(
        f"Noise of a layer's shortening, mm: {noise}; of ln stiffness {data['noise']['ln_stiffness']:.3f}. "
        f"Identification: {1000 * data['identification_processor_s_per_row']:.0f} processor ms a row. "
        f"Emulator: {data['emulator']}"
    )
    print(f"Stand out: {len(data['stands_out']['rows'])} rows, {len(data['stands_out']['people'])} people.")
    for each in data["warnings"]:
        print(f"warning: {each}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--table", type=Path, default=None)
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument(
        "--locations", nargs="*", default=None, help="only these; default: LL_A LL_P, then all"
    )
    given = parser.parse_args()
    table = given.table or shared_table()
    if not table.is_file():
        raise SystemExit(f"there is no {table}: set LIMBCLI_SHARED, or name a --table")
    folder = given.out or Path(tempfile.mkdtemp(prefix="cohort-"))
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [tuple(given.locations)] if given.locations is not None else [LEG, ()]
    for locations in wanted:
        started = time.process_time()
        name = "-".join(locations) or "all"
        result = cohort(part_of(table, locations, folder), out=folder / name)
        show(" and ".join(locations) or "all sites", dict(result.data), time.process_time() - started)
    print(f"\npages in {folder}")


if __name__ == "__main__":
    main()
