"""Formatting of numbers for readers: significant digits, unit, or a dash with its reason."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from limbcli.numbers.significant_digits import significant
from limbcli.reporting.reportlet import Cell, PageTable, table

DASH = "–"
_MOST_IN_A_ROW = 4
_THIN = "\u00a0"  # non-breaking space, keeps a number and its unit on one line


def signed_percent(share: float) -> str:
    """Percentage with its sign, unless it rounds to zero.

    >>> signed_percent(0.0123), signed_percent(-0.0002), signed_percent(-1.5)
    ('+1.2', '0.0', '-150.0')
    """
    return f"{100 * share:+.1f}" if abs(100 * share) >= 0.05 else "0.0"


def range_percent(shares: Iterable[object]) -> str:
    """Range of percentages, with their signs; a dash if none of the values is a number.

    >>> range_percent([-0.097, None, 0.02]), range_percent([None])
    ('-9.7 to +2.0 %', '–')
    """
    known = [share for each in shares if (share := number(each)) is not None]
    return f"{signed_percent(min(known))} to {signed_percent(max(known))} %" if known else DASH


def interval(found: Sequence[float | None] | None) -> str:
    """Both ends of an interval; "open" without any, a dash without an interval.

    >>> interval([3.5, None]), interval(None)
    ('above 3.50', '–')
    """
    low, high = (number(each) for each in found) if found else (None, None)
    if low is None and high is None:
        return "open" if found else DASH
    if low is None or high is None:
        return f"above {significant(low)}" if low is not None else f"below {significant(high or 0.0)}"
    return f"{significant(low)} to {significant(high)}"


def number(value: object) -> float | None:
    """A finite float, or None for anything else (null, NaN, text)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def cell(value: object, *, digits: int = 3, reason: str = "not in the result", unit: str = "") -> Cell:
    """A table cell; an undefined value is shown as a dash with its reason.

    >>> cell(2.5, unit="mm").text, cell(None, reason="no SWE").text, cell(None, reason="no SWE").reason
    ('2.50\xa0mm', '–', 'no SWE')
    """
    known = number(value)
    if known is None:
        return Cell(DASH, reason=reason)
    return Cell(significant(known, digits) + (f"{_THIN}{unit}".replace(" ", _THIN) if unit else ""))


def quantity(value: object, unit: str, *, digits: int = 3, reason: str = "not in the result") -> str:
    """
    >>> quantity(0.1234, "N"), quantity(None, "N", reason="no force")
    ('0.123 N', '– (no force)')
    """
    known = number(value)
    if known is None:
        return f"{DASH} ({reason})"
    return f"{significant(known, digits)} {unit}".rstrip()


_UNIT_ENDINGS = {
    "_m_per_s_per_mm": "m/s per mm", "_m_per_s_per_n": "m/s per N", "_m_per_s": "m/s",
    "_kg_per_m3": "kg/m³", "_n_per_mm": "N/mm", "_mm3": "mm³", "_mm2": "mm²", "_mm": "mm",
    "_kpa": "kPa", "_mpa": "MPa", "_ml": "ml", "_cm3": "cm³", "_n": "N", "_s": "s", "_deg": "°",
    "_percent": "%",
}  # fmt: skip


_OPTIONS = "asked"  # key of a result's options
_SHARES = ("share_below_", "share_above_")
_ROUNDING = 1e-9  # fraction of the largest of several numbers below which a number is rounding error
_EXTENTS = ("matrix", "spacing", "shape")  # lists joined by ×; other lists are coordinates


def named(key: str) -> tuple[str, str]:
    """Key of a result as words and unit.

    >>> named("edge_mean_mm"), named("n_nodes"), named("wave_speed_m_per_s")
    (('edge mean', 'mm'), ('number of nodes', ''), ('wave speed', 'm/s'))
    >>> named("share_below_10_deg")  # the unit is the limit's; a share has none
    ('share below 10 °', '')
    """
    words, unit = key, ""
    for ending, name in _UNIT_ENDINGS.items():
        if key.endswith(ending):
            words, unit = key[: -len(ending)], name
            break
    if words.startswith(_SHARES):
        words, unit = f"{words} {unit}".rstrip(), ""
    if words.startswith("n_"):
        words = "number of " + words[2:]
    return words.replace("_", " "), unit


def plain_rows(data: Mapping[str, Any], *, prefix: str = "", unit: str = "") -> list[tuple[Cell, ...]]:
    """The values of a result as rows (name, value with unit); nested tables are expanded.

    The options of the result are omitted, because its command shows them with their units.

    >>> for name, value in plain_rows({"volume_cm3": {"skin": 1626.6}, "n_slices": 56}):
    ...     print(name.text, "=", value.text)
    volume, skin = 1627...cm³
    number of slices = 56
    >>> [value.text for _, value in plain_rows({"spacing_mm": [1.0, 4.0], "normal": [-0.5, 0.9]})]
    ['1.00 × 4.00 mm', '-0.500, 0.900']
    >>> plain_rows({"long_axis": [1.0, 0.0, -1.22e-13]})[0][1].text  # what rounding leaves is no number
    '1.00, 0, 0'
    >>> plain_rows({"asked": {"size": 6.0}})
    []
    """
    rows: list[tuple[Cell, ...]] = []
    for key, value in data.items():
        if key == _OPTIONS:
            continue
        words, own = named(key)
        label, of = f"{prefix}{words}", own or unit
        if isinstance(value, Mapping):
            rows += plain_rows(value, prefix=f"{label}, ", unit=of)
        elif (shown := _shown(value, of, by=" × " if words.endswith(_EXTENTS) else ", ")) is not None:
            rows.append((Cell(label, lead=True), shown))
    return rows


def figures_table(caption: str, data: Mapping[str, Any]) -> PageTable:
    """The values of a result (`plain_rows`) as a table."""
    return table(caption, ("figure", "value"), plain_rows(data), numeric=False)


def _shown(value: object, unit: str, *, by: str) -> Cell | None:
    """One value as a cell, or None for a value that does not fit in one (long list, nested table).

    by : separator between the numbers of a list
    """
    if value is None:
        return Cell(DASH, reason="undefined for this result")
    if isinstance(value, bool):
        return Cell("yes" if value else "no")
    if isinstance(value, str):
        return Cell(value)
    if isinstance(value, int) and not unit:
        return Cell(f"{value:,}".replace(",", "\u202f"))
    if isinstance(value, int | float):
        return cell(value, digits=4, unit=unit)
    short = isinstance(value, list) and 0 < len(value) <= _MOST_IN_A_ROW
    if short and all(number(each) is not None for each in value):  # type: ignore[attr-defined]
        least = _ROUNDING * max(abs(each) for each in value)  # type: ignore[attr-defined]
        known = [0 if abs(each) <= least else each for each in value]  # type: ignore[attr-defined]
        texts = [str(each) if isinstance(each, int) else significant(each) for each in known]
        return Cell(by.join(texts) + (f" {unit}" if unit else ""))
    return None
