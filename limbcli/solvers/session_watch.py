"""Collects a session's results: records at every converged time, and derivatives at the levels."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np

from limbcli.model import Array, IntArray, LogRecord
from limbcli.solvers.session_parameters import Parameter
from limbcli.solvers.solver import Table

if TYPE_CHECKING:
    from limbcli.fem.analysis import Analysis, Snapshot
    from limbcli.fem.derivatives.parameters import Parameter as Differentiable

Rows = list[tuple[IntArray, Array]]


class StateObserver:
    """Visitor that is called with every converged state of an analysis.

    of_fields : differentiate all record fields (True), or those of these files
    rows : (ids, values) of each record at each time
    forces : d(force)/d(parameter) on the body at the levels
    slopes : du/d(parameter) by time and parameter
    """

    def __init__(
        self,
        requested: list[LogRecord],
        parameters: Mapping[Parameter, Differentiable],
        body: str,
        *,
        of_fields: bool | Collection[str],
    ):
        self.requested, self.parameters, self.body = requested, parameters, body
        self.rows: dict[str, Rows] = {each.file: [] for each in requested}
        self.forces: dict[Parameter, list[float]] = {name: [] for name in parameters}
        self.slopes: dict[float, dict[Parameter, Array]] = {}
        self._fields: dict[Parameter, dict[str, list[Array]]] = {
            name: {each.file: [] for each in requested if is_requested(each.file, of_fields)}
            for name in parameters
        }
        self._times: list[float] = []

    def __call__(self, running: Analysis, snapshot: Snapshot) -> None:
        from limbcli.fem.record_fields import record_rows

        for record in self.requested:
            rows = record_rows(running.system, snapshot.state, snapshot.forces, record)
            self.rows[record.file].append(rows)
        if self.parameters and snapshot.must:
            self._differentiate(running, snapshot)

    def force(self) -> float:
        """Force on the body (N, compression positive) at the last converged time."""
        record = next(each for each in self.requested if each.items == self.body)
        _, values = self.rows[record.file][-1]
        return -float(np.asarray(values).ravel()[record.fields.index("Fz")])

    def _differentiate(self, running: Analysis, snapshot: Snapshot) -> None:
        from limbcli.fem.derivatives.field_derivatives import record_derivatives
        from limbcli.fem.derivatives.sensitivity import sensitivities

        system, state = running.system, snapshot.state
        self._times.append(state.time)
        found = sensitivities(running.newton, state, snapshot.forces, list(self.parameters.values()))
        b = [body.name for body in system.bodies].index(self.body)
        for (name, parameter), each in zip(self.parameters.items(), found, strict=True):
            self.forces[name].append(-float(each.bodies[b, 2]))
            self.slopes.setdefault(state.time, {})[name] = each.displacement
            for record in self.requested:
                if record.file in self._fields[name]:
                    _, values = record_derivatives(system, state, record, parameter, each)
                    self._fields[name][record.file].append(values)

    def field_gradient(self) -> dict[Parameter, dict[str, Table]]:
        """d(field)/d(parameter) at the levels: tables by record file name, or by name of the body."""
        times = np.array(self._times)
        return {
            name: {
                key_of(record): Table(
                    record.fields, times, self.rows[record.file][0][0], np.stack(found[record.file])
                )
                for record in self.requested
                if found.get(record.file)
            }
            for name, found in self._fields.items()
        }


def is_requested(file: str, of_fields: bool | Collection[str]) -> bool:
    """Whether the fields of a record file are to be differentiated."""
    return of_fields if isinstance(of_fields, bool) else file in of_fields


def key_of(record: LogRecord) -> str:
    """The key of a record's table: the body's name, or the file name."""
    return str(record.items) if record.kind == "rigid_body" else record.file
