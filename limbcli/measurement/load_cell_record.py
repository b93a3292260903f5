"""Read a load-cell record as its program wrote it: other column names, separators, units, LabVIEW, TDMS.

`trace.csv` of the case format needs none of this; for an instrument that writes another format, case.toml
states the names and units of the columns.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.errors.problems import suggestion
from limbcli.measurement import lvm
from limbcli.measurement.column_units import (
    factor,
    is_called,
    is_unit,
    matches,
    quantity,
    stated_unit,
    stated_word,
)
from limbcli.measurement.number_table import number_of, shown
from limbcli.measurement.sheet import Sheet, cell, csv_sheet, is_number, text_of
from limbcli.measurement.tdms import is_tdms, tdms_sheet
from limbcli.measurement.trace import (
    LONGEST_S,
    RATES_HZ,
    TRACE_OPTIONAL,
    TRACE_REQUIRED,
    Trace,
    block_means,
    rate_question,
)
from limbcli.model import Array

_UNLOADED = 0.1  # share of the largest force below which a probe is taken as free
# a time of day, or since the start, with or without its date and time zone
_CLOCK = re.compile(
    r"(?:(\d{1,4}([-./])\d\d?\2\d{1,4})(?:T|,? ))?(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)"
    r"(?: ?([AP]M)|Z|[+-]\d\d:?\d\d)?",
    re.IGNORECASE,
)
_DAY_S = 86_400.0
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_NAMED = 4  # so many columns that are not read are named
_AVERAGED_HZ = 1000.0  # rate to which records are averaged that are faster than plausible ones
COLUMNS = (*TRACE_REQUIRED, *TRACE_OPTIONAL)


@dataclass(frozen=True)
class RecordingFormat:
    """Names and units of the columns.

    columns : our name -> the file's; names not given are searched for unchanged, or with another unit
    time_unit, force_unit, length_unit : None: as the file states it, else s, N, mm
    separator, decimal : None: detected automatically
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    time_unit: str | None = None
    force_unit: str | None = None
    length_unit: str | None = None
    separator: str | None = None
    decimal: str | None = None

    @property
    def units(self) -> dict[str, str | None]:
        return {key: getattr(self, key) for key in ("time_unit", "force_unit", "length_unit")}


def read_recording(path: Path, form: RecordingFormat | None = None) -> Trace:
    """Read a load-cell record of any of the usual formats.

    Returns the trace in our units, time from the file.

    Raises MeasurementError if it is a binary file, a row cannot be read, a column is missing or duplicated, a
    cell is not a number, a unit is not known or contradicts case.toml, time does not increase or cannot be in
    its unit, or a LabVIEW file has its force and another column at different times.
    """
    form = form or RecordingFormat()
    sheet = _with_unit_row(_sheet(path, form))
    positions = {}
    for name in COLUMNS:
        position = _position(sheet, form.columns.get(name, name), name, path, requested=name in form.columns)
        if position is not None:
            positions[name] = position
    if "time_s" not in positions and lvm.TIME in sheet.header:
        positions["time_s"] = list(sheet.header).index(lvm.TIME)
    for name in ("time_s", "force_n"):
        if name not in positions:
            fix = f'state which one it is: columns = {{ {name} = "..." }}; ' + suggestion(name, sheet.header)
            if all(map(is_number, sheet.header)):
                fix = f"begin the file with the names of its columns, such as {','.join(TRACE_REQUIRED)}"
            fix += "; readings without times go into levels.csv, one row for each" * (name == "time_s")
            raise MeasurementError(f"the record has no column {name!r}", where=str(path), fix=fix)
    if sheet.header[positions["time_s"]] == lvm.TIME and list(sheet.header).count(lvm.TIME) > 1:
        positions["time_s"] = _time_of_force(sheet, positions, path)
        timed = [row for row in sheet.rows if cell(row, positions["time_s"])]  # other channels may be longer
        sheet = Sheet(sheet.header, timed, sheet.separator, sheet.units)
    values = _values(sheet, positions, form, path)
    _check_time(values["time_s"], path)
    k = positions["time_s"]
    in_file = "s" if _in_clock(sheet, k) else stated_word(sheet.header[k], "time_s", sheet.unit(k), {})
    unit = in_file if _in_clock(sheet, k) else form.time_unit or in_file
    averaged = ""
    if in_file is not None and (n := _fast(values["time_s"])):
        values = {name: block_means(each, n) for name, each in values.items()}
        averaged = f"means of {n} samples"
    _check_rate(values["time_s"], path, unit)
    words = [_converted(sheet, positions, form), averaged]
    if _pulls(values["force_n"]) and "accel_x_g" not in values:
        values["force_n"] = -values["force_n"]
        words.append("its forces are negative: taken as compression, and counted as positive")
    words.append(_passed_over(sheet, positions))
    told = "; ".join(each for each in words if each)
    return Trace.of(values, path, converted=told)


def _fast(time: Array) -> int:
    """How many samples are averaged in a record that is faster than plausible ones; 0 if it is not."""
    rate = 1.0 / float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    return round(rate / _AVERAGED_HZ) if rate > 1.01 * RATES_HZ[1] else 0


def _pulls(force: Array) -> bool:
    """Whether a record that begins unloaded goes to negative forces only: an indenter cannot pull."""
    known = force[np.isfinite(force)]
    if not len(known):
        return False
    low, high, first = known.min(), known.max(), np.median(known[: max(1, len(known) // 100)])
    return bool(low < 0 and max(abs(high), abs(first)) < _UNLOADED * -low)


def _converted(sheet: Sheet, positions: Mapping[str, int], form: RecordingFormat) -> str:
    """The units that the file states and case.toml does not, in words."""
    given = form.units
    named = [
        f"{quantity(name).replace('_', ' ')} in {word}"
        for name in COLUMNS
        if name in positions
        and not _in_clock(sheet, positions[name])
        and (word := stated_word(sheet.header[k := positions[name]], name, sheet.unit(k), given)) is not None
    ]
    return f"units as the record states them: {', '.join(named)}" if named else ""


def _passed_over(sheet: Sheet, positions: Mapping[str, int]) -> str:
    """Columns of lengths that are not read, in words: "Extension (mm)" may be a depth or a travel."""
    titles = [
        repr(title[:40])
        for k, title in enumerate(sheet.header)
        if k not in positions.values()
        and is_unit(sheet.unit(k) or stated_unit(title, "depth_mm")[1], "depth_mm")
    ]
    told = f"not read: {', '.join(titles[:_NAMED])}; state it in columns if it is depth_mm or probe_travel_mm"
    return told if titles else ""


def _sheet(path: Path, form: RecordingFormat) -> Sheet:
    if is_tdms(path):
        wanted = {name: form.columns.get(name, name) for name in COLUMNS}
        return tdms_sheet(
            path, lambda title: any(_places([title], own, name) for name, own in wanted.items())
        )
    text = text_of(path)
    if lvm.is_lvm(text):
        return lvm.lvm_sheet(
            text, path, separator=form.separator, decimal=form.decimal, time_unit=form.time_unit
        )

    def has_columns(titles: Sequence[str]) -> bool:
        """Also without units, which may stand in the next line."""
        wanted = {name: form.columns.get(name, name) for name in TRACE_REQUIRED}
        return all(_places(titles, title, name, lambda _: True) for name, title in wanted.items())

    return csv_sheet(text, path, has_columns, separator=form.separator)


def _with_unit_row(sheet: Sheet) -> Sheet:
    """The sheet without a first row of units, "(s)" below "Time", which become those of its columns."""
    first = [each.strip().strip("()[]{} ") for each in sheet.rows[0]]
    is_told = any(is_unit(word, name) for word in first for name in TRACE_REQUIRED)
    if not is_told or any(map(is_number, first)):
        return sheet
    return Sheet(sheet.header, sheet.rows[1:], sheet.separator, first)


def _values(
    sheet: Sheet, positions: Mapping[str, int], form: RecordingFormat, path: Path
) -> dict[str, Array]:
    """Our columns in our units."""
    plain = [k for k in positions.values() if not _in_clock(sheet, k)]
    decimal = form.decimal or _decimal([cell(row, k) for row in sheet.rows[:50] for k in plain])
    values = {}
    for name, k in positions.items():
        if name == "time_s" and _in_clock(sheet, k):
            values[name] = _seconds(sheet.rows, k, path)
            continue
        if decimal == "," and form.decimal is None:
            _require_no_thousands(sheet, k, name, path)
        scale = factor(sheet.header[k], name, sheet.unit(k), form.units, path)
        values[name] = scale * _column(sheet.rows, k, decimal, name, path)
    return values


def _time_of_force(sheet: Sheet, positions: Mapping[str, int], path: Path) -> int:
    """The X_Value column of the force, of several that precede each a channel.

    Raises MeasurementError if another column that is read was sampled at different times.
    """
    times = {name: _time_before(sheet.header, k) for name, k in positions.items() if name != "time_s"}
    own = times["force_n"]
    for name, k in times.items():
        pairs = ((cell(row, own), cell(row, k)) for row in sheet.rows)
        if k != own and any(a != b for a, b in pairs if a and b):
            raise MeasurementError(
                f"force_n and {name} were sampled at different times (columns {own + 1} and {k + 1})",
                where=str(path),
                fix="export both at one rate (X_Columns One), or remove the column from the file",
            )
    return own


def _time_before(header: Sequence[str], position: int) -> int:
    """The nearest X_Value before a column; the first one if there is none before it."""
    before = [k for k, title in enumerate(header[:position]) if title == lvm.TIME]
    return before[-1] if before else list(header).index(lvm.TIME)


def _decimal(cells: list[str]) -> str:
    """The decimal mark: a comma if more cells have one than a point."""
    return "," if sum("," in each for each in cells) > sum("." in each for each in cells) else "."


def _places(
    titles: Sequence[str], wanted: str, name: str, unit: Callable[[int], bool] = lambda _: False
) -> list[int]:
    """The columns called `wanted`, else those called so beside a unit; `wanted` may be our own name.

    unit : whether another line than the header states one of a column; a column's own name goes before what
    testing machines call it
    """
    bare = [title.lstrip("#").strip() for title in titles]
    found = (
        [k for k, title in enumerate(titles) if title == wanted]
        or [k for k, title in enumerate(bare) if title == wanted]
        or [k for k, title in enumerate(bare) if stated_unit(title, name)[0] == wanted]
    )
    if found or wanted != name:
        return found
    for other_words in (False, True):
        for is_one in (
            lambda k, words=other_words: matches(bare[k], name, other_words=words),
            lambda k, words=other_words: is_called(bare[k], name, other_words=words) and unit(k),
        ):
            found = found or [k for k in range(len(bare)) if is_one(k)]
    return found


def _position(sheet: Sheet, wanted: str, name: str, path: Path, *, requested: bool) -> int | None:
    titles = sheet.header
    places = _places(titles, wanted, name, lambda k: is_unit(sheet.unit(k), name) or _in_clock(sheet, k))
    if len(places) > 1 and wanted != lvm.TIME:
        raise MeasurementError(
            f"{len(places)} columns of the record are called {wanted!r} "
            f"({', '.join(str(k + 1) for k in places)})",
            where=str(path),
            fix="give the whole title of one in columns; or rename the others, or export it without them",
        )
    if places:
        return places[0]
    if requested:
        what = f"the record has no column {wanted!r}, which case.toml names for {name}"
        raise MeasurementError(what, where=str(path), fix=suggestion(wanted, titles))
    return None


def _column(rows: list[list[str]], position: int, decimal: str, name: str, path: Path) -> Array:
    values = np.full(len(rows), np.nan)
    for k, row in enumerate(rows):
        text = cell(row, position)
        if not text:
            continue
        try:
            if decimal != "." and "." in text:  # might be a thousands separator: marks are never mixed
                raise ValueError
            values[k] = number_of(text.replace(decimal, "."))
        except ValueError:
            fix = 'remove the row, or say the decimal mark with decimal = ","'
            if decimal != "." and "." in text:
                fix = (
                    f"the decimal mark is a {decimal!r} here: write numbers without marks between thousands, "
                )
                fix += 'or state decimal = "."'
            elif _THOUSANDS.fullmatch(text):
                fix = "write numbers without marks between thousands"
            if ":" in text:
                fix = "write seconds, or hours:minutes:seconds, also after year-month-day, in every row"
            where = f"{path}, row {k + 1} below the header"
            raise MeasurementError(f"{name} is {shown(text)}, not a number", where=where, fix=fix) from None
    return values


def _in_clock(sheet: Sheet, position: int) -> bool:
    """Whether a column begins with a time of day, with or without its date."""
    return _CLOCK.fullmatch(sheet.cell(0, position)) is not None


def _seconds(rows: list[list[str]], position: int, path: Path) -> Array:
    """Times of day since the first of them, s; they may pass midnight.

    Of a date that does not begin with the year, day and month may be in either order: it tells only that a
    day is another than the one before, which must be the next.
    """
    values, dates = np.empty(len(rows)), []
    for k, row in enumerate(rows):
        text = cell(row, position)
        found = _CLOCK.fullmatch(text)
        try:
            day, mark, hour, minutes, seconds, half = found.groups()  # type: ignore[union-attr]
            is_known = mark and day.index(mark) == 4
            days = date(*map(int, day.split(mark))).toordinal() if is_known else 0
        except (AttributeError, ValueError):
            raise MeasurementError(
                f"time_s is {shown(text)}; the first row has a time of day",
                where=f"{path}, row {k + 1} below the header",
                fix="write all times alike: hours:minutes:seconds, also after year-month-day, or seconds",
            ) from None
        hours = int(hour) % 12 + 12 * (half.upper() == "PM") if half else int(hour)
        values[k] = 60 * (60 * (24 * days + hours) + int(minutes)) + float(seconds.replace(",", "."))
        dates.append(day if not is_known else "")
    is_midnight = np.diff(values, prepend=values[:1]) < -_DAY_S / 2
    for k in range(1, len(rows)):
        if dates[k] != dates[k - 1] and not is_midnight[k]:
            raise MeasurementError(
                f"the date changes from {shown(dates[k - 1] or '')} to {shown(dates[k] or '')}, and the time "
                "does not pass midnight",
                where=f"{path}, row {k + 1} below the header",
                fix="give a record of one measurement; or write dates as year-month-day",
            )
    return values + _DAY_S * np.cumsum(is_midnight) - values[0]


def _require_no_thousands(sheet: Sheet, position: int, name: str, path: Path) -> None:
    """Check that commas taken for decimal marks cannot be those of thousands: "980", then "1,017"."""
    cells = [text for row in sheet.rows if (text := cell(row, position))]
    marked = [each for each in cells if "," in each]
    if marked and len(marked) < len(cells) and all(map(_THOUSANDS.fullmatch, marked)):
        raise MeasurementError(
            f"{name} is {shown(marked[0])}, and other numbers have no comma: is it a decimal mark?",
            where=str(path),
            fix='write numbers without marks between thousands; if it is, state decimal = ","',
        )


def _check_time(time: Array, path: Path) -> None:
    missing = np.flatnonzero(~np.isfinite(time))
    if len(missing):
        raise MeasurementError(
            f"{len(missing)} row(s) have no time, the first is row {missing[0] + 1} below the header",
            where=str(path),
            fix="remove these rows, or give the right time column",
            n_rows=len(missing),
        )
    wrong = np.flatnonzero(~(np.diff(time) > 0))
    if len(wrong):
        k = int(wrong[0])
        raise MeasurementError(
            f"the time does not increase from row {k + 1} to {k + 2} ({time[k]:g}, {time[k + 1]:g} s)",
            where=str(path),
            fix="sort by time, remove repeated samples, or give the right time column",
            n_rows=len(wrong),
        )


def _check_rate(time: Array, path: Path, unit: str | None) -> None:
    """unit : of the file's times, if it is stated"""
    question = rate_question(time, unit=unit or "s", longest=np.inf if unit else LONGEST_S)
    if question:
        raise MeasurementError(
            question,
            where=str(path),
            fix='state the unit of its times: time_unit = "ms" (s, us, min) in [site.load_cell]; or '
            "export the record at 1 Hz to 10 kHz",
        )
