"""Read and check the load-cell record of an indentation, `trace.csv`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.errors.problems import Problem, checked, errors_of
from limbcli.measurement.level_checks import MAX_FORCE
from limbcli.measurement.number_table import problem, read_table
from limbcli.model import Array
from limbcli.numbers.units import TIME_UNITS_IN_S

RATES_HZ = (1.0, 10_000.0)  # of plausible records
_SLACK = 1.01  # rates are of clocks, and of times that were rounded
LONGEST_S = 7200.0  # of a plausible record
TRACE_REQUIRED = ("time_s", "force_n")
ACCELERATION = ("accel_x_g", "accel_y_g", "accel_z_g")
TRACE_OPTIONAL = ("depth_mm", "probe_travel_mm", *ACCELERATION)


@dataclass(frozen=True, eq=False)
class Trace:
    """The load-cell record: time s, force N and, if recorded, depth and travel mm, acceleration g.

    converted : a sentence on units that the file states, or ""
    """

    time: Array
    force: Array
    depth: Array | None
    probe_travel: Array | None
    acceleration_g: Array | None
    path: Path
    converted: str = ""

    @staticmethod
    def of(columns: Mapping[str, Array], path: Path, *, converted: str = "") -> Trace:
        """The record in columns by their names in trace.csv; acceleration only with all three of its axes."""
        axes = [columns[name] for name in ACCELERATION if name in columns]
        return Trace(
            time=columns["time_s"], force=columns["force_n"], depth=columns.get("depth_mm"),
            probe_travel=columns.get("probe_travel_mm"), path=path, converted=converted,
            acceleration_g=np.column_stack(axes) if len(axes) == len(ACCELERATION) else None,
        )  # fmt: skip

    def since(self, time_s: float) -> Trace:
        """The part of the record after a time."""
        late = self.time > time_s
        parts = (self.depth, self.probe_travel, self.acceleration_g)
        depth, travel, acceleration = (None if each is None else each[late] for each in parts)
        return Trace(
            self.time[late], self.force[late], depth, travel, acceleration, self.path, self.converted
        )


def block_means(values: Array, n: int) -> Array:
    """Means (m // n,) of n values each; what is left at the end is dropped.

    >>> block_means(np.arange(7.0), 3)
    array([1., 4.])
    """
    return np.asarray(values[: len(values) // n * n].reshape(-1, n).mean(axis=1))


def rate_question(time: Array, *, unit: str = "s", longest: float = LONGEST_S) -> str:
    """A question about the unit of a record's times (n,), s; empty if they are plausible.

    unit : that the file's times were taken in; longest : s, of a plausible record

    >>> rate_question(np.arange(0.0, 60.0, 0.01))
    ''
    >>> rate_question(np.arange(0.0, 60_000.0, 10.0))
    'the record has 0.1 samples per second: are its times in ms, not in s?'
    """
    if len(time) < 2:
        return ""
    step = float(np.median(np.diff(time)))
    rate, lasts = 1.0 / step, len(time) * step  # without pauses between the segments of a record
    if _is_rate(rate) and lasts <= longest:
        return ""
    found = f"lasts {lasts / 3600:.3g} hours" if _is_rate(rate) else f"has {rate:.3g} samples per second"
    scales = {name: size / TIME_UNITS_IN_S[unit] for name, size in TIME_UNITS_IN_S.items() if name != unit}
    fitting = [
        name for name, scale in scales.items() if _is_rate(rate / scale) and lasts * scale <= LONGEST_S
    ]
    return f"the record {found}: are its times in {' or '.join(fitting) or 'another unit'}, not in {unit}?"


def _is_rate(rate_hz: float) -> bool:
    return RATES_HZ[0] / _SLACK <= rate_hz <= RATES_HZ[1] * _SLACK


def read_trace(path: Path) -> Trace:
    """Read and check `trace.csv`.

    Raises MeasurementError with every problem of the file and its line.
    """
    return checked(*check_trace(path), MeasurementError)


def check_trace(path: Path) -> tuple[Trace | None, list[Problem]]:
    """The trace, if it is usable, and every problem."""
    table, problems = read_table(path, required=TRACE_REQUIRED, optional=TRACE_OPTIONAL)
    if table is None or errors_of(problems):
        return None, problems
    time = table.numbers["time_s"]
    for k in np.flatnonzero(np.diff(time) <= 0)[:3]:
        what = f"time_s does not increase ({time[k]:g} then {time[k + 1]:g} s)"
        problems.append(problem(what, path, "sort by time; remove repeated samples", line=table.lines[k + 1]))
    question = "" if errors_of(problems) else rate_question(time, longest=np.inf)
    if question:
        problems.append(problem(question, path, "the column is in s: convert it"))
    elif not errors_of(problems) and (question := rate_question(time)):
        problems.append(problem(question, path, "the column is in s: convert it, if it is not", warning=True))
    if np.abs(table.numbers["force_n"]).max() > MAX_FORCE:
        what = f"force_n reaches {np.abs(table.numbers['force_n']).max():g} N"
        problems.append(problem(what, path, "the column is in N (is it in grams?)"))
    missing = [name for name in ACCELERATION if name not in table.numbers]
    if missing and len(missing) < len(ACCELERATION):
        problems.append(problem(f"{', '.join(missing)} is missing", path, "give all three axes or none"))
    return Trace.of(table.numbers, path), problems
