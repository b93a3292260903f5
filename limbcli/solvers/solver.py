"""The interface of all solvers: five independent operations, and the result type `Simulation`.

`found` and `version` report the installation; `write` writes the input file; `run` computes and writes
the result files; `read` turns the result files of any solver into a `Simulation`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from limbcli.model import Array, IntArray, LimbModel
from limbcli.progress import Progress

MODEL_FILE = "model.feb"
LOG_FILE = "model.log"


@dataclass(frozen=True, eq=False)
class Table:
    """One log record: values (n_times, n_items, n_fields), items numbered from 0."""

    fields: tuple[str, ...]
    times: Array
    items: IntArray
    values: Array

    def column(self, name: str) -> Array:
        """The values (n_times, n_items) of one field."""
        return self.values[:, :, self.fields.index(name)]


@dataclass(frozen=True, eq=False)
class Simulation:
    """A finished simulation: the times of all converged steps, and the tables requested by the model.

    rigid : by body name; nodes, elements : by file name of the record
    warnings : what the solver's log warns of
    """

    solver: str
    version: str
    times: Array
    rigid: Mapping[str, Table]
    nodes: Mapping[str, Table] = field(default_factory=dict)
    elements: Mapping[str, Table] = field(default_factory=dict)
    n_iterations: int = 0
    n_factorisations: int = 0
    seconds: float = 0.0
    linear_solver: str = ""
    warnings: tuple[str, ...] = ()

    def probe_force(self, body: str = "probe") -> Array:
        """Probe force (n_times,), N, compression positive: minus the rigid body's Fz."""
        return -self.rigid[body].column("Fz")[:, 0]

    def probe_depth(self, body: str = "probe") -> Array:
        """Probe depth (n_times,), mm: minus the height of the probe face (the body's centre of mass)."""
        return -self.rigid[body].column("z")[:, 0]


class Solver(Protocol):
    """The interface implemented by `solvers.febio` and `solvers.reference`."""

    name: str

    def found(self) -> bool: ...

    def version(self) -> str: ...

    def identity(self) -> str:
        """A string that changes if a different program would be run; limbcli's own sources do not count."""
        ...

    def write(self, model: LimbModel, folder: Path) -> Path: ...

    def run(self, feb: Path, *, progress: Progress, time_limit_s: float | None = None) -> None:
        """Compute; raises SolveError if the end of the load was not reached."""
        ...

    def read(self, feb: Path) -> Simulation: ...
