"""What a fit found when it solved its model again with other boundaries and a stiffer contact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.numbers.significant_digits import significant
from limbcli.reporting.numbers import DASH, interval, number, range_percent
from limbcli.reporting.reportlet import Cell, PageTable, table
from limbcli.reporting.sections.assumed_geometry import SYMBOLS

_BOUNDARIES = {"cut_free": "cut plane free, not held", "far_side_held": "far side held, not free"}


def model_check_tables(site: str, data: Mapping[str, Any]) -> tuple[PageTable, ...]:
    """One row for every change of the model; empty if nothing was checked.

    data : content of fit.json
    """
    rows = []
    boundaries = data.get("boundary_check")
    for key, label in _BOUNDARIES.items():
        found = boundaries.get(key) if isinstance(boundaries, Mapping) else None
        rows += [_row(label, found)] if isinstance(found, Mapping) else []
    contact = data.get("contact_check")
    if isinstance(contact, Mapping):
        rows.append(_row(_contact(contact), contact))
    if not rows:
        return ()
    caption = (
        f"Site {site}: the fitted model with other assumptions. How the limb was held is not measured: half "
        "of what a boundary changes counts as one standard deviation of the force"
    )
    names = ("changed", "force, over the levels", "f_κ that would fit", "m that would fit")
    return (table(caption, names, rows),)


def model_check_words(data: Mapping[str, Any]) -> str:
    """How far the simulated force moved with other assumptions, in a few words; "" if nothing was tried.

    data : content of fit.json

    >>> model_check_words({"boundary_check": {"cut_free": {"force_change_fraction": [-0.07, -0.1]}}})
    'tried with the fitted model: cut plane free, not held: force -10.0 to -7.0 %'
    """
    rows = [row for table in model_check_tables("", data) for row in table.rows]
    tried = [f"{row[0].text}: force {row[1].text}" for row in rows if row[1].text != DASH]
    return f"tried with the fitted model: {'; '.join(tried)}" if tried else ""


def noise_alone(data: Mapping[str, Any]) -> str:
    """The intervals without the uncertainty of boundaries and geometry; empty if they are not wider for it.

    data : content of fit.json
    """
    found = data.get("interval_95_noise")
    if not isinstance(found, Mapping):
        return ""
    parts = [f"{symbol} {interval(found.get(name))}" for name, symbol in SYMBOLS.items()]
    text = f"with noise and mesh alone, 95 %: {', '.join(parts)}"
    stated = data.get("interval_95")
    if isinstance(stated, Mapping) and all(stated.get(name) == each for name, each in found.items()):
        text += (
            "; these are the intervals stated, because what is uncertain in geometry and boundaries explains "
            "part of the scatter that otherwise counts as noise"
        )
    return text


def _row(label: str, found: Mapping[str, Any]) -> tuple[Cell, ...]:
    why = found.get("not_evaluated")
    if why is not None:
        return Cell(label, lead=True), Cell(DASH, reason=str(why), span=3)
    moved = [number(found.get(name)) for name in ("f_kappa", "m")]
    return (
        Cell(label, lead=True), Cell(range_percent(found["force_change_fraction"])),
        *(Cell(DASH if each is None else significant(each, 2)) for each in moved),
    )  # fmt: skip


def _contact(found: Mapping[str, Any]) -> str:
    """
    >>> _contact({"penalty": 20.0, "tried": 80.0})
    'contact 4 times as stiff'
    """
    penalty, tried = number(found.get("penalty")), number(found.get("tried"))
    times = f"{significant(tried / penalty, 1)} times as stiff" if penalty and tried else "stiffer"
    return f"contact {times}"
