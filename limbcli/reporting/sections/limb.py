"""Is the model of the whole limb right: its shape, its named parts, and its stiffness?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.reporting.numbers import DASH, quantity
from limbcli.reporting.report_data import ReportData
from limbcli.reporting.reportlet import Cell, PageTable, Reportlet, pictures_of, table
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
