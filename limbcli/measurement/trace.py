"""Read and check the load-cell record of an indentation, `trace.csv`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.errors.problems import Problem, checked
from limbcli.measurement.level_checks import MAX_FORCE
from limbcli.measurement.tables import problem, read_table
from limbcli.model import Array

TRACE_REQUIRED = ("time_s", "force_n")
TRACE_OPTIONAL = ("depth_mm", "probe_travel_mm", "accel_x_g", "accel_y_g", "accel_z_g")


@dataclass(frozen=True, eq=False)
class Trace:
    """The load-cell record: time s, force N and, if recorded, depth and travel mm, acceleration g."""

    time: Array
    force: Array
    depth: Array | None
    probe_travel: Array | None
    acceleration_g: Array | None
    path: Path

    def since(self, time_s: float) -> Trace:
        """The part of the record after a time."""
        late = self.time > time_s
        parts = (self.depth, self.probe_travel, self.acceleration_g)
        depth, travel, acceleration = (None if each is None else each[late] for each in parts)
        return Trace(self.time[late], self.force[late], depth, travel, acceleration, self.path)


def read_trace(path: Path) -> Trace:
    """Read and check `trace.csv`.

    Raises
    ------
    MeasurementError
        With every problem of the file and its line.
    """
    return checked(*check_trace(path), MeasurementError)


def check_trace(path: Path) -> tuple[Trace | None, list[Problem]]:
    """The trace, if it is usable, and every problem."""
    table, problems = read_table(path, required=TRACE_REQUIRED, optional=TRACE_OPTIONAL)
    if table is None or any(each.severity == "error" for each in problems):
        return None, problems
    time = table.numbers["time_s"]
    for k in np.flatnonzero(np.diff(time) <= 0)[:3]:
        what = f"time_s does not increase ({time[k]:g} then {time[k + 1]:g} s)"
        problems.append(problem(what, path, "sort by time; remove repeated samples", line=table.lines[k + 1]))
    if np.abs(table.numbers["force_n"]).max() > MAX_FORCE:
        what = f"force_n reaches {np.abs(table.numbers['force_n']).max():g} N"
        problems.append(problem(what, path, "the column is in N (is it in grams?)"))
    accelerations = [f"accel_{axis}_g" for axis in "xyz"]
    present = [name for name in accelerations if name in table.numbers]
    if present and len(present) < len(accelerations):
        missing = sorted(set(accelerations) - set(present))
        problems.append(problem(f"{', '.join(missing)} is missing", path, "give all three axes or none"))
    trace = Trace(
        time=time,
        force=table.numbers["force_n"],
        depth=table.numbers.get("depth_mm"),
        probe_travel=table.numbers.get("probe_travel_mm"),
        acceleration_g=np.column_stack([table.numbers[n] for n in accelerations])
        if len(present) == len(accelerations)
        else None,
        path=path,
    )
    return trace, problems
