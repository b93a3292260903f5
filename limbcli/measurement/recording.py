"""Read a load-cell record as its program wrote it: other column names, separators, units, LabVIEW files.

`trace.csv` of the case format needs none of this; for an instrument that writes another format, case.toml
states the names and units of the columns.
"""

from __future__ import annotations

import codecs
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.errors.problems import checked, suggestion
from limbcli.measurement.tables import csv_rows, number_of
from limbcli.measurement.trace import Trace
from limbcli.model import Array
from limbcli.units import FORCE_UNITS_IN_N, LENGTH_UNITS_IN_MM

LVM_END_OF_HEADER = "***End_of_Header***"
_SEGMENT = "Channels"  # first word of a segment's header
_LVM_TIME = "X_Value"  # name of the time column before every channel of a file with X_Columns Multi
COLUMNS = ("time_s", "force_n", "depth_mm", "probe_travel_mm", "accel_x_g", "accel_y_g", "accel_z_g")


@dataclass(frozen=True)
class RecordingFormat:
    """Names and units of the columns.

    columns : our name -> the file's; names not given are searched for unchanged
    separator, decimal : None: detected automatically
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    force_unit: str = "N"
    length_unit: str = "mm"
    separator: str | None = None
    decimal: str | None = None


def read_recording(path: Path, form: RecordingFormat | None = None) -> Trace:
    """Read a load-cell record of any of the usual formats.

    Returns
    -------
    Trace in our units, time from the file.

    Raises
    ------
    MeasurementError
        If a row cannot be read, a column is missing or duplicated, a cell is not a number, time does not
        increase, or a LabVIEW file has its force and another column at different times.
    """
    form = form or RecordingFormat()
    header, rows, separator = _table(path, form)
    decimal = form.decimal or _decimal(rows, separator)
    positions = {}
    for name in COLUMNS:
        position = _position(header, form.columns.get(name, name), name, path, requested=name in form.columns)
        if position is not None:
            positions[name] = position
    for name in ("time_s", "force_n"):
        if name not in positions:
            fix = f'state which one it is: columns = {{ {name} = "..." }}; ' + suggestion(name, header)
            raise MeasurementError(f"the record has no column {name!r}", where=str(path), fix=fix)
    if header[positions["time_s"]] == _LVM_TIME and header.count(_LVM_TIME) > 1:
        positions["time_s"] = _time_of_force(header, rows, positions, path)
        rows = [row for row in rows if _cell(row, positions["time_s"])]  # other channels may be longer
    values = {name: _column(rows, k, decimal, name, path) for name, k in positions.items()}
    _check_time(values["time_s"], path)
    length = LENGTH_UNITS_IN_MM[form.length_unit]
    axes = [values.get(f"accel_{axis}_g") for axis in "xyz"]
    return Trace(
        time=values["time_s"],
        force=values["force_n"] * FORCE_UNITS_IN_N[form.force_unit],
        depth=values["depth_mm"] * length if "depth_mm" in values else None,
        probe_travel=values["probe_travel_mm"] * length if "probe_travel_mm" in values else None,
        acceleration_g=np.column_stack([each for each in axes if each is not None])
        if all(each is not None for each in axes)
        else None,
        path=path,
    )


def _table(path: Path, form: RecordingFormat) -> tuple[list[str], list[list[str]], str]:
    text = _without_comments(_text(path).splitlines(), form)
    lines = [line for line in text if line.strip()]
    if any(line.startswith(LVM_END_OF_HEADER) for line in lines):
        return _lvm_table(lines, path, form)
    if len(lines) < 2:
        fix = "give the file that the load cell's program wrote"
        raise MeasurementError("the record has no rows", where=str(path), fix=fix)
    separator = form.separator or max(("\t", ";", ","), key=lambda mark: lines[0].count(mark))
    cells = checked(*csv_rows("\n".join(text), path, separator=separator), MeasurementError)
    rows = [row for row in cells if separator.join(row).strip()]
    return [cell.strip() for cell in rows[0]], rows[1:], separator


def _without_comments(text: list[str], form: RecordingFormat) -> list[str]:
    """Blank out lines that begin with #, keeping line numbers, as in `trace.csv`.

    A header may begin with # too: if the first other line contains none of the wanted columns, all lines are
    kept.
    """
    bare = ["" if line.startswith("#") else line for line in text]
    header = next((line for line in bare if line.strip()), "")
    return bare if any(form.columns.get(name, name) in header for name in COLUMNS) else text


def _lvm_table(lines: list[str], path: Path, form: RecordingFormat) -> tuple[list[str], list[list[str]], str]:
    """Parse a LabVIEW measurement file: a header, then segments, each with its own header.

    If the segments contain no times (X_Columns No), each channel's X_Value is computed from its X0 and
    Delta_X. Times that restart are offset by the start of their segment, according to the clock in its
    header.
    """
    ends = [k for k, line in enumerate(lines) if line.startswith(LVM_END_OF_HEADER)]
    mark = form.separator or _lvm_separator(lines[: ends[0]])
    header: list[str] = []
    rows: list[list[str]] = []
    own: dict[str, list[str]] = {}  # header entries so far, of the file and the segments
    begin = 0
    clocks: list[float | None] = []
    for k, end in enumerate(ends):
        last = ends[k + 1] if k + 1 < len(ends) else len(lines)
        body = [line.split(mark) for line in lines[end + 1 : last]]
        own |= {cells[0]: cells[1:] for line in lines[begin:end] for cells in [line.split(mark)]}
        begin = end + 1
        if not body or body[0][0].strip() == _SEGMENT:
            continue
        titles, segment = [cell.strip() for cell in body[0]], _data_rows(body[1:])
        if own.get("X_Columns", [""])[0].strip() == "No":
            titles, segment = _with_times(titles, segment, own, path, form.decimal)
        if header and titles != header:
            what = f"the segments have different columns: {', '.join(header)}; then {', '.join(titles)}"
            raise MeasurementError(what, where=str(path), fix="export one segment per file")
        header = titles
        clocks.append(_clock(own))
        rows += _after(rows, segment, header, clocks, comma=_has_comma(segment, form.decimal))
    if not rows:
        fix = "give the file that the load cell's program wrote"
        raise MeasurementError("the record has no rows", where=str(path), fix=fix)
    return header, rows, mark


def _clock(own: Mapping[str, list[str]]) -> float | None:
    """Start time of a segment, s, from the Date and Time in its header; None if missing or invalid."""
    day, time = (own.get(key, [""])[0].strip() for key in ("Date", "Time"))
    minute, _, seconds = time.replace(",", ".").rpartition(":")
    try:
        begun = datetime.strptime(f"{day.replace('-', '/')} {minute}", "%Y/%m/%d %H:%M")
        return (begun - datetime(1970, 1, 1)).total_seconds() + float(seconds)
    except ValueError:
        return None


def _after(
    rows: list[list[str]], segment: list[list[str]], header: list[str], clocks: list[float | None], *,
    comma: bool,
) -> list[list[str]]:  # fmt: skip
    """A segment's rows; if its times restart, they are offset to count from the start of the first segment.

    clocks : start times of the segments up to this one; comma : whether the decimal mark is a comma
    """
    first, own = clocks[0], clocks[-1]
    times = [k for k, title in enumerate(header) if title == _LVM_TIME]
    ends = _numbers_of([_cell(each[0], times[0]) for each in (rows[-1:], segment) if each and times])
    if len(ends) < 2 or ends[1] > ends[0] or first is None or own is None:
        return segment
    later = [list(row) for row in segment]
    for row in later:
        for k in times:
            for number in _numbers_of([_cell(row, k)]):
                text = repr(number + own - first)
                row[k] = text.replace(".", ",") if comma else text
    return later


def _has_comma(rows: list[list[str]], decimal: str | None) -> bool:
    """Whether numbers are written with a decimal comma."""
    return decimal == "," if decimal else any("," in cell for row in rows[:50] for cell in row)


def _lvm_separator(header: list[str]) -> str:
    named = next((line for line in header if line.startswith("Separator")), "")
    return "," if named.endswith("Comma") else "\t"


def _data_rows(body: list[list[str]]) -> list[list[str]]:
    """The data rows up to the next segment's header."""
    rows = []
    for cells in body:
        if cells[0].strip() == _SEGMENT:
            break
        rows.append(cells)
    return rows


def _with_times(
    titles: list[str], rows: list[list[str]], own: Mapping[str, list[str]], path: Path, decimal: str | None
) -> tuple[list[str], list[list[str]]]:
    """The table with a time column before each channel.

    A channel without X0 and Delta_X uses the last ones.
    """
    starts, steps = (_numbers_of(own.get(key, [])) for key in ("X0", "Delta_X"))
    known = list(zip(starts, steps, strict=False))
    if not known:
        raise MeasurementError(
            "the file has no times: X_Columns is No, and X0 or Delta_X is missing",
            where=str(path),
            fix="save it with one X column",
        )
    comma = _has_comma(rows, decimal)
    channels = [known[min(j, len(known) - 1)] for j in range(len(titles) - 1)]
    timed = []
    for k, row in enumerate(rows):
        cells: list[str] = []
        for j, (start, step) in enumerate(channels, 1):
            value = _cell(row, j)
            time = repr(start + k * step) if value else ""
            cells += [time.replace(".", ",") if comma else time, value]
        timed.append(cells)
    return [each for title in titles[1:] for each in (_LVM_TIME, title)], timed


def _numbers_of(cells: list[str]) -> list[float]:
    """The numbers before the first cell that is not a number."""
    found = []
    for cell in cells:
        try:
            found.append(float(cell.replace(",", ".")))
        except ValueError:
            break
    return found


def _time_of_force(header: list[str], rows: list[list[str]], positions: Mapping[str, int], path: Path) -> int:
    """The X_Value column of the force, of several that precede each a channel.

    Raises
    ------
    MeasurementError
        If another column that is read was sampled at different times.
    """
    times = {name: _time_before(header, k) for name, k in positions.items() if name != "time_s"}
    own = times["force_n"]
    for name, k in times.items():
        pairs = ((_cell(row, own), _cell(row, k)) for row in rows)
        if k != own and any(a != b for a, b in pairs if a and b):
            raise MeasurementError(
                f"force_n and {name} were sampled at different times (columns {own + 1} and {k + 1})",
                where=str(path),
                fix="export both at one rate (X_Columns One), or remove the column from the file",
            )
    return own


def _time_before(header: list[str], position: int) -> int:
    """The nearest X_Value before a column; the first one if there is none before it."""
    before = [k for k, title in enumerate(header[:position]) if title == _LVM_TIME]
    return before[-1] if before else header.index(_LVM_TIME)


def _cell(row: list[str], position: int) -> str:
    return row[position].strip() if position < len(row) else ""


def _text(path: Path) -> str:
    content = path.read_bytes()
    marked = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    for encoding in (*(["utf-16"] if marked else []), "utf-8-sig", "latin-1"):
        try:
            return content.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise AssertionError("latin-1 decodes any bytes")


def _decimal(rows: list[list[str]], separator: str) -> str:
    """The decimal mark: a comma if it is not the separator and is more frequent than points in the cells."""
    sample = [cell for row in rows[:50] for cell in row]
    commas = sum("," in cell for cell in sample)
    return "," if separator != "," and commas > sum("." in cell for cell in sample) else "."


def _position(header: list[str], wanted: str, name: str, path: Path, *, requested: bool) -> int | None:
    places = [k for k, title in enumerate(header, 1) if title == wanted]
    if len(places) > 1 and wanted != _LVM_TIME:
        raise MeasurementError(
            f"{len(places)} columns of the record are called {wanted!r} ({', '.join(map(str, places))})",
            where=str(path),
            fix="rename the others, or export the record without them",
        )
    if wanted in header:
        return header.index(wanted)
    if requested:
        what = f"the record has no column {wanted!r}, which case.toml names for {name}"
        raise MeasurementError(what, where=str(path), fix=suggestion(wanted, header))
    return None


def _column(rows: list[list[str]], position: int, decimal: str, name: str, path: Path) -> Array:
    values = np.full(len(rows), np.nan)
    for k, row in enumerate(rows):
        cell = _cell(row, position)
        if not cell:
            continue
        try:
            if decimal != "." and "." in cell:  # might be a thousands separator: marks are never mixed
                raise ValueError
            values[k] = number_of(cell.replace(decimal, "."))
        except ValueError:
            fix = 'remove the row, or say the decimal mark with decimal = ","'
            if decimal != "." and "." in cell:
                fix = (
                    f"the decimal mark is a {decimal!r} here: write numbers without marks between thousands, "
                )
                fix += 'or state decimal = "."'
            if ":" in cell:
                fix = "write seconds: a time of day or a date is not read as time"
            where = f"{path}, row {k + 1} below the header"
            raise MeasurementError(f"{name} is {cell!r}, not a number", where=where, fix=fix) from None
    return values


def _check_time(time: Array, path: Path) -> None:
    wrong = np.flatnonzero(~(np.diff(time) > 0))
    if len(wrong):
        k = int(wrong[0])
        raise MeasurementError(
            f"the time does not increase from row {k + 1} to {k + 2} ({time[k]:g}, {time[k + 1]:g} s)",
            where=str(path),
            fix="sort by time, remove repeated samples, or give the right time column",
            n_rows=len(wrong),
        )
