"""The whole limb as a model, and pressure and shear on its skin in the socket."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from limbcli.reporting.figures.scene import pressure_scene
from limbcli.reporting.numbers import DASH, quantity
from limbcli.reporting.report_data import ReportData
from limbcli.reporting.reportlet import Cell, PageTable, Picture, Reportlet, pictures_of, table
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.results import StageResult

_CAPTION = (
    "each coloured patch over its bone, the limb upright with its distal end below; sites left out and "
    "predicted from the others inside their intervals",
    "a patch on the wrong side, a bone cut off where it should end, a limb of elements that are all assumed: "
    "its stiffness then is no measurement",
)


@of_stage("limb", "limb", "Is the model of the whole limb right?")
def limb(result: StageResult, _: ReportData) -> Reportlet:
    """Picture of the named parts, and where the stiffness comes from."""
    alt = "The limb's model from four sides, its named patches and the sites."
    look_for, bad = _CAPTION
    return Reportlet(
        mood="warning" if result.warnings else "neutral",
        pictures=pictures_of(result, {"picture": ("limb", alt)}),
        tables=(_stiffness(result.data["stiffness"]), *_left_out(result.data["stiffness"].get("field"))),
        look_for=look_for,
        bad=bad,
        notes=result.summary,
        warned=result.warnings,
    )


def _stiffness(data: Mapping[str, Any]) -> PageTable:
    """Mean c and the share of the elements by where their c comes from."""
    counts = {name: int(n) for name, n in data["elements"].items()}
    total = max(sum(counts.values()), 1)
    names = ("mean c", *(f"{name} elements" for name in counts))
    shares = (Cell(f"{100 * n / total:.0f} %") for n in counts.values())
    row: tuple[Cell | str, ...] = (quantity(float(data["c_kpa"]), "kPa", digits=3), *shares)
    return table(f"Stiffness of the tissue: {data['source']}", names, [row])


def _left_out(field: Mapping[str, Any] | None) -> tuple[PageTable, ...]:
    """Each site predicted from the others; none without a field."""
    sites = ((field or {}).get("held_out") or {}).get("sites") or ()
    rows = []
    for each in sites:
        low, high = each["predicted_95_kpa"]
        inside = "inside" if each["inside"] else "outside"
        predicted = f"{each['predicted_kpa']:.1f} ({low:.1f} to {high:.1f})"
        c = Cell(f"{each['c_kpa']:.1f}") if each["c_kpa"] else Cell(DASH, reason="not known")
        rows.append((each["site"], c, Cell(predicted), Cell(inside)))
    names = ("site left out", "its c", "c from the others (95 %)", "interval")
    return (table("Each site predicted without itself, kPa", names, rows),) if rows else ()


_SCENE = ("points", "displacement", "triangles", "pressure_kpa")
_COLUMNS = ("mean_kpa", "p95_kpa", "peak_kpa", "mean_shear_kpa")


@of_stage("socket", "socket", "How does the socket press on the limb?")
def socket(result: StageResult, _: ReportData) -> Reportlet:
    """Pressure and shear by patch."""
    return Reportlet(
        mood="warning" if result.warnings else "neutral",
        pictures=_pictures(result),
        tables=(_table(result.data),),
        look_for="pressure spread over the patches that bear load, and forces that leave nothing over",
        bad="a rim of high pressure at the brim or the proximal cut, pressure on single facets, or skin far "
        "behind the wall: then mesh or contact decide, not the limb",
        notes=result.summary,
        warned=result.warnings,
    )


def _pictures(result: StageResult) -> tuple[Picture, ...]:
    """Pictures of the states, and a 3-D view of the last one (its picture, where there is no WebGL)."""
    pressed = result.data["pressed"]
    alt = f"Pressure on the {pressed} from four sides and unrolled about the limb's axis."
    names = [name for name in result.files if name.startswith("picture_")]
    found = pictures_of(result, {name: (name.replace("_", "-"), alt) for name in names})
    if not found or "skin" not in result.files or not result.path("skin").is_file():
        return found
    with np.load(result.path("skin")) as stored:
        scene = pressure_scene(**{name: stored[name] for name in _SCENE})
    alt = f"Pressure on the {pressed} under the last load."
    return (*found, replace(found[-1], name="socket-3d", alt=alt, scene=scene))


def _table(data: Mapping[str, Any]) -> PageTable:
    limits = {
        (each["load_n"], each["patch"], each["quantity"]): (each["low"], each["high"])
        for each in (data.get("intervals") or {}).get("patches", ())
    }
    rows: list[tuple[Cell | str, ...]] = []
    for each in data["patches"]:
        load, patch = each["load_n"], each["patch"]
        cells = [_cell(each[name], limits.get((load, patch, name))) for name in _COLUMNS]
        when = f"{load:g} N" if load else "donned"
        area = quantity(each["contact_area_mm2"] / 100.0, "cm²", digits=2)
        rows.append((f"{when}: {patch.replace('_', ' ')}", area, *cells))
    names = ("load and patch", "in contact", "mean", "95th percentile", "peak", "mean shear")
    title = f"Pressure and shear on the {data['pressed']}, kPa"
    return table(title + (" (95 % over the limb's draws)" if limits else ""), names, rows)


def _cell(value: float, limits: tuple[float, float] | None) -> Cell:
    ends = "" if limits is None else f" ({limits[0]:.1f} to {limits[1]:.1f})"
    return Cell(f"{value:.1f}{ends}")
