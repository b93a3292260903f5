"""Log and record files of the reference solver, in FEBio's format."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING

import numpy as np

from limbcli.feb.log import warning_box
from limbcli.feb.outline import Outline
from limbcli.feb.read_control import FINAL, MAJOR, MUST_POINTS, output_level
from limbcli.model import Array, IntArray, LimbModel, LogRecord, Step
from limbcli.solvers.solver import LOG_FILE

if TYPE_CHECKING:
    from limbcli.fem.analysis import Analysis, Snapshot
    from limbcli.fem.motion.state import Forces

_RULE = "=" * 75
_STARS = "*" * 73


def output_of(step: Step) -> tuple[int, int]:
    """(output level, stride) of the records of an analysis step.

    Source: FEBio 4.11, FEBioModel::WriteData.
    """
    level = output_level(str(step.control.get("output_level", MAJOR)))
    return MAJOR if level is None else level, int(step.control.get("output_stride", 1))


def _unloaded(forces: Forces) -> Forces:
    """Forces with zero reactions, as FEBio logs before the first step, where nothing is in equilibrium."""
    return replace(forces, nodal=np.zeros_like(forces.nodal), bodies=np.zeros_like(forces.bodies))


class RunFiles:
    """Open files of one run; a context manager that logs an error termination on an exception.

    outline : outline of the model file, whose ids of cells and rigid materials the records use
    """

    def __init__(self, model: LimbModel, folder: Path, *, outline: Outline, version: str, mark: str):
        self.model, self.folder = model, folder
        self._ids = {"node": np.arange(1, outline.n_nodes + 1), "element": outline.cell_ids}
        self._body_ids = {name: int(number) for number, name in outline.bodies.items()}
        self._stack = contextlib.ExitStack()
        for name in (LOG_FILE, *(record.file for record in model.records)):
            (folder / name).unlink(missing_ok=True)
        self._log = self._stack.enter_context((folder / LOG_FILE).open("w", encoding="utf-8"))
        self._files: dict[str, IO[str]] = {}
        self._finished = False
        self._said_solver = False
        self._unwritten: Snapshot | None = None
        self._output = [output_of(step) for step in model.steps]
        self._write_log(f"{_RULE}\n  limbcli reference solver\n  version {version}\n{_RULE}\n")
        self._write_log(f" FILES USED\n{_RULE}\n\tModel file : {mark}\n")

    def __enter__(self) -> RunFiles:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            lines = "\n".join(f" * {line}" for line in str(error).splitlines())
            self._write_log(f" {_STARS}\n * ERROR\n{lines}\n {_STARS}\n")
        if not self._finished:
            self._write_log("\n E R R O R   T E R M I N A T I O N\n")
        self._stack.close()

    def step(self, analysis: Analysis, snapshot: Snapshot) -> None:
        """Write a converged step to the log and to every record file."""
        if not self._said_solver:
            self._first(analysis)
        time = snapshot.state.time
        counts = analysis.newton.counts
        self._write_log(f"===== beginning time step {snapshot.step} : {time:.12g} =====")
        self._write_log(
            f" touching points {snapshot.forces.n_touching}, residual {snapshot.forces.error:.3e},"
            f" iterations so far {counts.iterations}, factorisations {counts.factorisations}"
        )
        self._write_log(f"------- converged at time : {time:.12g}\n")
        level, stride = self._output[snapshot.part]
        due = snapshot.step % stride == 0 if level == MAJOR else level == MUST_POINTS and snapshot.listed
        if due:
            self._records(analysis, snapshot.step, time, snapshot)
        self._unwritten = None if due else snapshot
        self._log.flush()

    def warning(self, text: str) -> None:
        """Write a warning, in the form of FEBio's, which makes it one of the run."""
        self._write_log(warning_box(text))

    def note(self, text: str) -> None:
        """Write one line to the log."""
        if text:
            self._write_log(f" {text}\n")

    def finish(self, analysis: Analysis, seconds: float) -> None:
        """Write the last step if it has not been, the totals, and the line that marks a finished run."""
        last = self._unwritten
        if last is not None and self._output[last.part][0] in (MAJOR, FINAL):
            self._records(analysis, last.step, last.state.time, last)
        counts = analysis.totals()
        self._write_log(" N O N L I N E A R   I T E R A T I O N   S U M M A R Y\n")
        self._write_log(f"\tTotal number of equilibrium iterations ............ : {counts.iterations}\n")
        self._write_log(f"\tTotal number of right hand evaluations ............ : {counts.residuals}\n")
        self._write_log(f"\tTotal number of stiffness reformations ............ : {counts.factorisations}\n")
        self._write_log(f"\tTotal elapsed time .............. : 0:00:00 ({seconds:.3f} sec)\n")
        self._write_log("\n N O R M A L   T E R M I N A T I O N\n")
        self._finished = True

    def _first(self, analysis: Analysis) -> None:
        self._said_solver = True
        self._write_log(f" {_STARS}\n * Selecting linear solver {analysis.newton.linear_name}\n {_STARS}\n")
        self._write_log(f"\tNumber of equations ............ : {analysis.system.n_unknowns}\n")
        if self._output[0][0] == MAJOR:
            self._records(analysis, 0, 0.0, None)

    def _records(self, analysis: Analysis, step: int, time: float, snapshot: Snapshot | None) -> None:
        from limbcli.fem.record_fields import STRESS_FIELDS, record_rows

        system = analysis.system
        if snapshot is None:
            state = system.rest()
            now = system.time
            system.at(0.0)
            forces = _unloaded(system.forces(state))
            # FEBio has not applied a prestrain then, nor evaluated any stress
            system.operands = [replace(each, base=np.eye(3)) for each in system.operands]
        else:
            state, forces = snapshot.state, snapshot.forces
        for record in self.model.records:
            ids, values = record_rows(system, state, forces, record)
            if snapshot is None:
                values = np.where([name in STRESS_FIELDS for name in record.fields], 0.0, values)
            self._write(record, step, time, ids, values)
        if snapshot is None:
            system.at(now)

    def _write(self, record: LogRecord, step: int, time: float, ids: IntArray, values: Array) -> None:
        if record.file not in self._files:
            self._files[record.file] = self._stack.enter_context((self.folder / record.file).open("w"))
        stream = self._files[record.file]
        title = record.items if record.kind == "rigid_body" else ";".join(record.fields)
        stream.write(f"*Step  = {step}\n*Time  = {time:.12g}\n*Data  = {title}\n")
        if record.kind == "rigid_body":
            ids = np.array([self._body_ids[str(record.items)]])
        else:
            ids = self._ids[record.kind][ids]
        table = np.column_stack([ids, values])
        np.savetxt(stream, table, fmt=["%d"] + ["%.12g"] * values.shape[1], delimiter=",")
        stream.flush()

    def _write_log(self, text: str) -> None:
        self._log.write(text + "\n")
