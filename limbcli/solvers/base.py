"""What every solver answers: five verbs, each callable alone, and one result.

`found` and `version` report what is there; `write` leaves the input file; `run`
computes and leaves the result files; `read` turns result files, whoever made
them, into a `Simulation`.
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
    """One log record read back: values (n_times, n_items, n_fields), items numbered from 0."""

    fields: tuple[str, ...]
    times: Array
    items: IntArray
    values: Array

    def column(self, name: str) -> Array:
        """(n_times, n_items) of one field."""
        return self.values[:, :, self.fields.index(name)]


@dataclass(frozen=True, eq=False)
class Simulation:
    """A finished simulation: every converged step's time, and the tables the model asked for.

    rigid : by body name; nodes, elements : by file name of the record
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

    def probe_force(self, body: str = "probe") -> Array:
        """(n_times,) N, compression positive: minus the rigid body's Fz."""
        return -self.rigid[body].column("Fz")[:, 0]

    def probe_depth(self, body: str = "probe") -> Array:
        """(n_times,) mm: minus the height of the probe face (the body's centre of mass)."""
        return -self.rigid[body].column("z")[:, 0]


class Solver(Protocol):
    """The contract that `solvers.febio` and `solvers.reference` keep."""

    name: str

    def found(self) -> bool: ...

    def version(self) -> str: ...

    def identity(self) -> str:
        """Words that change where another program would be started; our own sources are not meant."""
        ...

    def write(self, model: LimbModel, folder: Path) -> Path: ...

    def run(self, feb: Path, *, progress: Progress, time_limit_s: float | None = None) -> None:
        """Compute; raises SolveError where the end of the load was not reached."""
        ...

    def read(self, feb: Path) -> Simulation: ...
