"""Read LabVIEW's TDMS files with npTDMS: channels in groups, with their own rates and units.

Properties of channels (National Instruments, "The NI TDMS File Format", and what NI-DAQmx logs):
`unit_string` or `NI_UnitDescription`, the unit; `wf_increment` and `wf_start_offset`, s, the times.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.errors import MeasurementError, ToolError
from limbcli.measurement.lvm import TIME
from limbcli.measurement.sheet import Sheet

EXTRA = "tdms"
_MAGIC = b"TDSm"
_UNITS = ("unit_string", "NI_UnitDescription")
_MOST = 20_000_000  # samples of all channels that are read


def is_tdms(path: Path) -> bool:
    """Whether a file begins like a TDMS file. Raises OSError if it cannot be read."""
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


def tdms_sheet(path: Path, is_wanted: Callable[[str], bool]) -> Sheet:
    """The wanted channels as columns, each after its times if the file states its rate.

    is_wanted : whether a column of this title is read. Channels of the same name in several groups are called
    group/channel.

    Raises ToolError if npTDMS is not installed; MeasurementError if the file is damaged or cut short, or has
    no wanted channel or no values in it.
    """
    try:
        from nptdms import TdmsFile
    except ImportError as error:
        raise ToolError(
            "npTDMS is missing, which reads LabVIEW's TDMS files",
            where=str(path),
            fix=f"pip install 'limbcli[{EXTRA}]' (or npTDMS), or export the record as text: .lvm or CSV",
        ) from error
    try:
        with _warnings() as warned, TdmsFile.open(path) as file:
            channels = [each for group in file.groups() for each in group.channels()]
            names = Counter(each.name for each in channels)
            titled = [
                (each.name if names[each.name] == 1 else f"{each.group_name}/{each.name}", each)
                for each in channels
            ]
            wanted = [(title, each) for title, each in titled if is_wanted(title)]
            n_samples = sum(len(each) for _, each in wanted)
            columns = [_columns(title, each) for title, each in wanted] if n_samples <= _MOST else []
    except Exception as error:  # npTDMS raises what numpy and struct raise on damaged files
        raise MeasurementError(
            f"the TDMS file cannot be read ({type(error).__name__})",
            where=str(path),
            fix="copy it again from the machine that wrote it, or export it as text: .lvm or CSV",
        ) from error
    if warned:
        raise MeasurementError(
            "the TDMS file is damaged, or was cut short while it was written",
            where=str(path),
            fix="copy it again from the machine that wrote it, or export what it holds as text: .lvm or CSV",
        )
    if n_samples > _MOST:
        raise MeasurementError(
            f"the TDMS file has {n_samples} samples; at most {_MOST} are read",
            where=str(path),
            fix="export the part with the measurement, at a lower rate",
        )
    if not n_samples:
        found = ", ".join(repr(title[:40]) for title, _ in titled[:20]) or "none"
        raise MeasurementError(
            f"the TDMS file has no values of a channel called as the case format does; its channels: {found}",
            where=str(path),
            fix='state which is which: columns = { force_n = "..." } in [site.load_cell]',
        )
    flat = [column for own in columns for column in own]
    rows = [list(row) for row in zip_longest(*(cells for _, _, cells in flat), fillvalue="")]
    return Sheet([title for title, _, _ in flat], rows, "\t", [unit for _, unit, _ in flat])


@contextmanager
def _warnings() -> Iterator[list[str]]:
    """Collect what npTDMS warns of: it writes it to the terminal, with the bytes of a damaged file."""
    from nptdms.log import log_manager

    found: list[str] = []

    def keep(record: logging.LogRecord) -> bool:
        found.append(record.levelname)
        return False

    loggers = list(log_manager.loggers.values())
    for each in loggers:
        each.addFilter(keep)
    try:
        yield found
    finally:
        for each in loggers:
            each.removeFilter(keep)


_Column = tuple[str, str, list[str]]  # title, unit, cells


def _columns(title: str, channel: Any) -> list[_Column]:
    """The channel's times, if the file states them, and its values."""
    values = np.asarray(channel[:])
    properties = channel.properties
    unit = next((str(properties[each]).strip() for each in _UNITS if properties.get(each)), "")
    if values.dtype.kind == "M":  # times of day
        since = (values - values[:1]) / np.timedelta64(1, "ns") * 1e-9
        return [(title, "s", _cells(since))]
    own = (title, unit, _cells(values.astype(np.float64)))
    step = float(properties.get("wf_increment", 0.0) or 0.0)
    if not step > 0:
        return [own]
    start = float(properties.get("wf_start_offset", 0.0) or 0.0)
    unit_of_time = str(properties.get("wf_xunit_string") or "s")
    return [(TIME, unit_of_time, _cells(start + step * np.arange(len(values)))), own]


def _cells(values: Iterable[float]) -> list[str]:
    return [repr(float(each)) for each in values]
