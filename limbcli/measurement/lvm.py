"""Read LabVIEW measurement files (.lvm): a header, then segments, each with its own header.

Format: National Instruments, Specification for the LabVIEW Measurement File (.lvm), version 2.0.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

from limbcli.errors import MeasurementError
from limbcli.measurement.sheet import Sheet, cell, is_number
from limbcli.numbers.units import TIME_UNITS_IN_S, unit_named

_END_OF_HEADER = "***End_of_Header***"
TIME = "X_Value"  # name of the time column; before every channel of a file with X_Columns Multi
_SEPARATOR = "Separator"
_DEFAULT = "Default SI Unit"  # what a missing label stands for


def is_lvm(text: str) -> bool:
    return any(line.startswith(_END_OF_HEADER) for line in text.splitlines())


def lvm_sheet(
    text: str, path: Path, *, separator: str | None, decimal: str | None, time_unit: str | None
) -> Sheet:
    """The cells of all segments, one below the other.

    If the segments contain no times (X_Columns No), each channel's X_Value is computed from its X0 and
    Delta_X. Times that restart are offset by the start of their segment, according to the clock in its
    header. Units are those of X_Unit_Label and Y_Unit_Label; time_unit : of the times, where it has no label

    Raises MeasurementError if it has no rows or no times, or its segments have different columns or units.
    """
    lines = [line for line in text.splitlines() if line.strip()]
    ends = [k for k, line in enumerate(lines) if line.startswith(_END_OF_HEADER)]
    mark = separator or _separator(lines[: ends[0]])
    header: list[str] = []
    units: list[str] = []
    rows: list[list[str]] = []
    own: dict[str, list[str]] = {}  # header entries so far, of the file and the segments
    begin = 0
    clocks: list[float | None] = []
    for k, end in enumerate(ends):
        body = [line.split(mark) for line in lines[end + 1 : ends[k + 1] if k + 1 < len(ends) else None]]
        own |= {cells[0].strip(): cells[1:] for line in lines[begin:end] for cells in [line.split(mark)]}
        if mark == "," and own.get("Decimal_Separator", ["."])[0].strip() == "":
            what = "the record has commas both between its columns and as decimal marks"
            raise MeasurementError(what, where=str(path), fix="save it with tabs between the columns")
        if k + 1 < len(ends):
            body = _without_header(body)
        begin = end + 1 + len(body)
        if not body:
            continue
        titles, segment = [each.strip() for each in body[0]], body[1:]
        labels = _labels(own, titles)
        if cell(own.get("X_Columns", []), 0) == "No":
            titles, segment = _with_times(titles, segment, own, path, decimal)
            labels = [each for label in labels[1:] for each in (labels[0], label)]
        if header and (titles, labels) != (header, units):
            words = [", ".join(" ".join(each).strip() for each in zip(a, b, strict=False))
                     for a, b in ((header, units), (titles, labels))]  # fmt: skip
            what = f"the segments have different columns: {words[0]}; then {words[1]}"
            raise MeasurementError(what, where=str(path), fix="export one segment per file")
        header, units = titles, labels
        clocks.append(_clock(own))
        second = 1.0 / TIME_UNITS_IN_S[unit_named(labels[0], TIME_UNITS_IN_S) or time_unit or "s"]
        comma = _has_comma(segment, decimal)
        rows += _after(rows, segment, header, clocks, second=second, comma=comma)
    if not rows:
        fix = "give the file that the load cell's program wrote"
        raise MeasurementError("the record has no rows", where=str(path), fix=fix)
    return Sheet(header, rows, mark, units)


def _separator(header: list[str]) -> str:
    """The mark that follows the word `Separator` in the file's header; a tab if it has none."""
    named = next((line for line in header if line.startswith(_SEPARATOR)), "")
    return named[len(_SEPARATOR)] if len(named) > len(_SEPARATOR) else "\t"


def _without_header(body: list[list[str]]) -> list[list[str]]:
    """Titles and data up to the next segment's header, whose lines all begin with a word."""
    n = len(body)
    while n and body[n - 1][0].strip() and not is_number(body[n - 1][0]):
        n -= 1
    return body[:n]


def _labels(own: Mapping[str, list[str]], titles: list[str]) -> list[str]:
    """The unit of each column; they stand in the columns of the channels, that of the time in the first."""
    time, *of_channels = (
        "" if label.strip() == _DEFAULT else label.strip()
        for label in [cell(own.get("X_Unit_Label", []), 0), "", *own.get("Y_Unit_Label", [])]
    )
    return [time if title == TIME else cell(of_channels, k) for k, title in enumerate(titles)]


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
    second: float, comma: bool,
) -> list[list[str]]:  # fmt: skip
    """A segment's rows; if its times restart, they are offset to count from the start of the first segment.

    clocks : start times of the segments up to this one, s; second : in the unit of the times; comma : whether
    the decimal mark is a comma
    """
    first, own = clocks[0], clocks[-1]
    times = [k for k, title in enumerate(header) if title == TIME]
    ends = _numbers_of([cell(each[0], times[0]) for each in (rows[-1:], segment) if each and times])
    if len(ends) < 2 or ends[1] > ends[0] or first is None or own is None:
        return segment
    later = [list(row) for row in segment]
    for row in later:
        for k in times:
            for number in _numbers_of([cell(row, k)]):
                text = repr(number + second * (own - first))
                row[k] = text.replace(".", ",") if comma else text
    return later


def _has_comma(rows: list[list[str]], decimal: str | None) -> bool:
    """Whether numbers are written with a decimal comma."""
    return decimal == "," if decimal else any("," in each for row in rows[:50] for each in row)


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
            value = cell(row, j)
            time = repr(start + k * step) if value else ""
            cells += [time.replace(".", ",") if comma else time, value]
        timed.append(cells)
    return [each for title in titles[1:] for each in (TIME, title)], timed


def _numbers_of(cells: list[str]) -> list[float]:
    """The numbers before the first cell that is not a number."""
    found = []
    for each in cells:
        try:
            found.append(float(each.replace(",", ".")))
        except ValueError:
            break
    return found
