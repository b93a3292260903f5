"""Reads the record files of a finished run into a `Simulation`; common to all solvers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from limbcli.feb.log import check_complete, read_log
from limbcli.feb.log_identity import check_belongs
from limbcli.feb.outline import Outline, read_outline
from limbcli.feb.records import Records, broken_record, read_records
from limbcli.model import Array, LogRecord
from limbcli.solvers.solver import LOG_FILE, Simulation, Table


@dataclass(frozen=True, eq=False)
class Tables:
    times: Array
    rigid: dict[str, Table]
    nodes: dict[str, Table]
    elements: dict[str, Table]


def read_finished(solver: str, feb: Path) -> Simulation:
    """The results of a finished run, from the files next to its model file.

    Raises SolveError if the log reports an incomplete run or another model, or a record file is incomplete.
    """
    outline = read_outline(feb)
    path = feb.parent / LOG_FILE
    log = read_log(path)
    check_complete(log, path, end_time=outline.end_time)
    check_belongs(path, feb, outline)
    tables = read_tables(outline, feb.parent)
    return Simulation(
        solver=solver,
        version=log.version,
        times=tables.times if outline.records else np.array([0.0, *log.times]),
        rigid=tables.rigid,
        nodes=tables.nodes,
        elements=tables.elements,
        n_iterations=log.n_iterations,
        n_factorisations=log.n_reformations,
        seconds=log.seconds,
        linear_solver=log.linear_solver,
        warnings=log.warnings,
    )


def read_tables(outline: Outline, folder: Path) -> Tables:
    """Read all record files of a model and check them against each other.

    Raises SolveError if a file is missing, truncated or inconsistent with its record, or its times differ
    from the others'.
    """
    rigid: dict[str, Table] = {}
    nodes: dict[str, Table] = {}
    elements: dict[str, Table] = {}
    times: Array | None = None
    for record in outline.records:
        path = folder / record.file
        records = read_records(path, n_columns=len(record.fields))
        if records.truncated:
            raise broken_record(path, "it is truncated in the middle of a step")
        if times is not None and not np.array_equal(records.times, times):
            raise broken_record(path, "its times differ from those of the other record files")
        times = records.times
        table = _table(record, records, outline, path)
        if record.kind == "rigid_body":
            body = str(record.items)
            rigid[body] = _side_by_side(rigid[body], table) if body in rigid else table
        else:
            (nodes if record.kind == "node" else elements)[record.file] = table
    return Tables(np.zeros(0) if times is None else times, rigid, nodes, elements)


def _side_by_side(one: Table, other: Table) -> Table:
    """Merge two records of a body: fields of `other` that `one` lacks are appended."""
    new = [k for k, name in enumerate(other.fields) if name not in one.fields]
    return replace(
        one,
        fields=(*one.fields, *(other.fields[k] for k in new)),
        values=np.concatenate([one.values, other.values[:, :, new]], axis=2),
    )


def _table(record: LogRecord, records: Records, outline: Outline, path: Path) -> Table:
    if record.kind == "rigid_body":
        if len(records.ids) != 1:
            raise broken_record(path, f"it holds {len(records.ids)} rigid bodies where one was requested")
        items = np.zeros(1, dtype=np.int64)
    else:
        by_place = np.arange(-1, outline.n_nodes)
        numbers = by_place if record.kind == "node" else outline.cells
        if records.ids.max() >= len(numbers) or (numbers[records.ids] < 0).any():
            raise broken_record(path, f"it contains {record.kind}s that the model does not have")
        items = numbers[records.ids]
    return Table(fields=record.fields, times=records.times, items=items, values=records.values)
