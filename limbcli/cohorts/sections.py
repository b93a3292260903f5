"""The page of a cohort and its pictures in a folder next to it: displays the content of `cohort.json`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from limbcli.cohorts import figures as drawn
from limbcli.numbers.significant_digits import significant
from limbcli.reporting.numbers import DASH, cell
from limbcli.reporting.page import embed, render, save_pictures
from limbcli.reporting.reportlet import Cell, Picture, Reportlet, table

Data = Mapping[str, Any]
_NAMES = (
    ("c_muscle_kpa", "c of muscle", "kPa"),
    ("c_fat_kpa", "c of fat, in the bonded slab", "kPa"),
    ("m", "m", ""),
)
_LISTED = 25
PICTURES = "pictures"
TEMPLATE = "cohort.html.j2"
_PICTURES = frozenset({"distributions", "misfits", "one-tissue", "left-out"})
_ENDINGS = (".png", ".svg", "-data.csv")


def cohort_page(data: Mapping[str, Any], out: Path, name: str, *, templates: Path | None = None) -> Path:
    """Write `<out>/<name>` and `<out>/pictures/`, in a new folder; the page needs no other file."""
    makers = (population, standing_out, misfits, one_tissue, left_out, grounds)  # in reading order
    reportlets = [make(data) for make in makers]
    (out / PICTURES).mkdir()
    shown = embed(reportlets, save_pictures(reportlets, out / PICTURES))
    facts = {"data": data, "reportlets": reportlets, "shown": shown, "own": data["provenance"]}
    html = render(TEMPLATE, facts, templates=templates)
    (out / name).write_text(html, encoding="utf-8")
    return out / name


def is_ours(path: Path) -> bool:
    """Whether a file in the folder of pictures has the name of a cohort's picture.

    >>> is_ours(Path("pictures/left-out-data.csv")), is_ours(Path("pictures/holiday.png"))
    (True, False)
    """
    return any(path.name.removesuffix(each) in _PICTURES for each in _ENDINGS if path.name.endswith(each))


def population(data: Data) -> Reportlet:
    rows = []
    for site, own in data["sites"].items():
        for k, (key, name, unit) in enumerate(_NAMES):
            value = own["population"][key]
            first = (Cell(f"{site} ({own['n_rows']} rows)", lead=True, down=3),) if k == 0 else ()
            interval = f"{significant(value['low'])} to {significant(value['high'])}"
            low, high = (math.exp(value[f"spread_of_ln_{end}"]) for end in ("low", "high"))
            spread = f"×/÷ {value['spread_factor']:.2f} ({low:.2f} to {high:.2f})"
            middle = cell(value["geometric_mean"], unit=unit)
            if value["beyond_family"]:
                middle = Cell(value["beyond_family"], reason="the family ends there")
                interval = spread = DASH
            known = f"{100 * value['mean_shrinkage']:.0f} %"
            rows.append((*first, Cell(name), middle, Cell(interval), Cell(spread), Cell(known)))
    names = (
        "site", "parameter", "geometric mean of the people", "95 % interval of the mean",
        "spread between people", "determined by the population",
    )  # fmt: skip
    caption = "Population of every site: geometric means and spreads as factors"
    alt = "c of muscle, c of fat and m of every row with 95 % intervals, and each site’s population"
    figure = drawn.distributions(data["rows"], data["sites"])
    return Reportlet(
        "population",
        "What are the tissue properties of these people?",
        pictures=(Picture("distributions", alt, figure=figure),),
        tables=(table(caption, names, rows, numeric=False),),
        look_for="dots (people, with their 95 % intervals) that spread beyond their intervals: people "
        "differ. The bar at the "
        "right of each site is the population’s geometric mean (line) and spread (pale)",
        bad="intervals as long as the pale bar, and a high share “determined by the population”: "
        "the readings carry little "
        "information about that parameter, and a person’s value is mostly the population’s",
    )


def standing_out(data: Data) -> Reportlet:
    found = data["stands_out"]
    people = [
        (each["subject"], str(each["n_rows"]), each["muscle"], _two(each["z"]), _two(each["p_adjusted"]))
        for each in found["people"][:_LISTED]
    ]
    rows = [
        (each["subject"], each["location"], str(each["line"]), _two(each["p_adjusted"]))
        for each in found["rows"][:_LISTED]
    ]
    tables = []
    if people:
        caption = f"People whose muscle differs over all of their sites{_first(found['people'])}"
        tables.append(table(caption, ("person", "rows", "muscle is", "z", "p, adjusted"), people))
    if rows:
        caption = f"Rows outside what their site’s population predicts{_first(found['rows'])}"
        tables.append(table(caption, ("person", "site", "line", "p, adjusted"), rows))
    rows_words = f"{len(found['rows'])} row{'' if len(found['rows']) == 1 else 's'}"
    people_words = f"{len(found['people'])} {'person' if len(found['people']) == 1 else 'people'}"
    counts = (
        f"{rows_words} and {people_words} stand out at {100 * found['level']:g} %, adjusted for all looked "
        "at (Holm)."
    )
    return Reportlet(
        "stands-out",
        "Who stands out?",
        "warning" if tables else "fine",
        tables=tuple(tables),
        notes=(counts,),
        look_for="the rows named here: consider a transcription error or a bad image first, then a person "
        "unlike the others",
        bad="a list as long as the table: then the model is wrong for this site, not the people",
    )


def _two(value: object) -> Cell:
    return cell(value, digits=2)


def _first(found: Sequence[object]) -> str:
    """
    >>> _first([1, 2]), _first(range(40))
    ('', ', the first 25 of 40')
    """
    return f", the first {_LISTED} of {len(found)}" if len(found) > _LISTED else ""


def misfits(data: Data) -> Reportlet:
    alt = "measured and predicted share of fat and of skin in the shortening, one dot per row"
    return Reportlet(
        "misfits",
        "What does the model miss?",
        pictures=(Picture("misfits", alt, figure=drawn.misfits(data["rows"])),),
        look_for="dots on the line at the left: fat and muscle shorten as the fitted layers do",
        bad="a cloud off the line. At the right nothing was fitted: skin is held five times as stiff as "
        "muscle, and its shortening is of the size of the marks’ noise",
    )


def one_tissue(data: Data) -> Reportlet:
    rows = (
        (
            site,
            _two(own["homogeneous"]["median_noise_deviations"]),
            _two(own["homogeneous"]["median_absolute_noise_deviations"]),
            f"{100 * own['homogeneous']['share_beyond_2']:.0f} %",
            _two(own["c_fat_over_c_muscle"]),
        )
        for site, own in data["sites"].items()
    )
    names = ("site", "median", "median of the absolute value", "rows beyond 2", "c of fat / c of muscle")
    caption = "Fat’s shortening in excess of that of one tissue, in standard deviations of the edges’ noise"
    alt = (
        "by how many noise deviations fat shortens more than one homogeneous tissue would, over fat thickness"
    )
    return Reportlet(
        "one-tissue",
        "Would one homogeneous tissue suffice?",
        pictures=(Picture("one-tissue", alt, figure=drawn.one_tissue(data["rows"])),),
        tables=(table(caption, names, rows),),
        look_for="dots within the band: fat and muscle move like one tissue of the bonded slab. Below it, "
        "fat shortens less: it is stiffer, or muscle slides on the bone, or skin and fascia are stiff",
        bad="most dots outside: a homogeneous model deforms differently from the tissue",
    )


def left_out(data: Data) -> Reportlet:
    found = data["compliance_left_out"]
    key, title = "left-out", "How well is the compliance of held-out people predicted?"
    if found["mean_absolute_difference_percent"] is None:
        return Reportlet(key, title, "warning", warned=(found["reason"],))
    same = found["same_folds"]
    rows = [
        ("this prediction, from thicknesses", found["mean_absolute_difference_percent"]),
        ("springs in series, same folds", same["springs_in_series_percent"]),
        ("linear, site by site, same folds", same["linear_site_by_site_percent"]),
        ("each site’s mean, same folds", same["sites_mean_percent"]),
    ]
    person = found["with_person_columns"]
    if person:
        rows.insert(1, (f"with {', '.join(person['columns'])}", person["mean_absolute_difference_percent"]))
    repeat = found["repeatability"]
    rows.append(("of which marks and slope alone", repeat["percent_from_marks_and_slope_alone"]))
    if repeat["percent_from_trials"] is not None:
        rows.append(("of which repeatability (trials)", repeat["percent_from_trials"]))
    low, high = found["interval_95_percent"]
    worst = found["largest_row"]
    models = table(
        "Mean of |predicted − measured| / measured, ten folds by person. With other people the first "
        f"would be between {low:.1f} and {high:.1f} % (95 %); one row alone ({worst['subject']}, "
        f"{worst['location']}, {worst['difference_percent']:.0f} % off) contributes "
        f"{worst['share_of_the_mean_percent']:.1f} points of it",
        ("model", "percent"),
        ((name, cell(value)) for name, value in rows),
    )
    alt = "predicted against measured compliance of held-out people, by site"
    return Reportlet(
        key,
        title,
        pictures=(Picture("left-out", alt, figure=drawn.compliance(found["rows"])),),
        tables=(models,),
        look_for="dots along the line, within the grey band",
        bad="one site off the line (its tissue differs), or a flat cloud (thickness is not predictive there)",
        notes=(repeat["reason"],) if repeat.get("reason") else (),
    )


def grounds(data: Data) -> Reportlet:
    noise, emulator = data["noise"], data["emulator"]
    error = emulator["left_out_error"]
    elsewhere = "taken from the others" if any(noise["from_data"].values()) else "assumed"
    here, held_out = "from this table", "one standard deviation, held-out members"
    rows = [
        (f"noise of the {layer}’s shortening", f"{significant(value, 2)} mm",
         here if noise["from_data"][layer] else elsewhere)
        for layer, value in noise["layer_shortened_mm"].items()
    ]  # fmt: skip
    rows += [
        ("noise of the stiffness", f"{100 * noise['ln_stiffness']:.1f} %",
         here if noise["ln_stiffness_from_data"] else "assumed"),
        ("simulations behind the emulator", str(emulator["n_solves"]),
         f"and {emulator['n_solves_on_finer_mesh']} on a finer mesh"),
        ("emulator’s error of the force", f"{error['force_percent']:.1f} %", held_out),
        ("emulator’s error of muscle’s share (logit)", significant(error["logit_muscle_part"], 2), held_out),
    ]  # fmt: skip
    return Reportlet(
        "grounds",
        "What are these numbers based on?",
        tables=(table("Noise and emulator", ("what", "value", "whence"), rows, numeric=False),),
        look_for="noise well below a layer’s shortening, and an emulator error below it",
        bad="an assumed noise: the intervals are only as reliable as that assumption",
        notes=(
            "The model is a flat layered slab on a rigid base under a face four times as long as wide: the "
            "limb’s shape is not known. c depends on this assumed shape; compare people at one site, and "
            "sites only with care.",
        ),
    )
