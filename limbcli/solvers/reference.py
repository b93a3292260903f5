"""The bundled reference solver: reads a `.feb` file, leaves the files that FEBio would leave.

`ReferenceSolver` keeps the contract of all solvers; `ReferenceSession` keeps a model
in memory, solves it again with other parameters from where it was, and gives exact
derivatives of the probe's force.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import limbcli
from limbcli.errors import SolveError
from limbcli.feb.log import check_complete, read_log
from limbcli.feb.outline import read_outline
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.model import Array, ElementMap, IntArray, LimbModel, LogRecord
from limbcli.progress import SILENT, Progress
from limbcli.solvers.base import LOG_FILE, MODEL_FILE, Simulation, Table
from limbcli.solvers.reference_files import RunFiles
from limbcli.solvers.tables import read_tables

if TYPE_CHECKING:
    from limbcli.fem.analysis import Analysis, Snapshot
    from limbcli.fem.system import State

NAME = "reference"
_DIFFERENCE = 1e-3  # of a parameter, for responses that cannot be differentiated exactly
_SMOOTH_TOLERANCE = 1e-11  # without contact, Newton's last digits cost next to nothing
Parameter = tuple[str, str]


@dataclass
class ReferenceSolver:
    """The reference solver behind the five verbs.

    threads : 1 or 2 and so on; linear : "auto", "pardiso" or "superlu"
    tolerance : residual over the forces at play
    """

    threads: int = 2
    linear: str = "auto"
    tolerance: float = 1e-6
    name: str = NAME

    def found(self) -> bool:
        return True

    def version(self) -> str:
        return limbcli.__version__

    def write(self, model: LimbModel, folder: Path) -> Path:
        return write_feb(model, folder / MODEL_FILE)

    def run(self, feb: Path, *, progress: Progress, time_limit_s: float | None = None) -> None:
        """Solve a model file in its folder; the log and the record files appear beside it.

        Raises
        ------
        CaseError, SolveError
            If the file holds something that is not supported (before anything is
            computed), if a level is not reached, or if the time limit passes.
        """
        model = read_feb(feb)
        with RunFiles(model, feb.parent, version=self.version()) as files:
            self._compute(model, files, progress, time_limit_s)

    def _compute(
        self, model: LimbModel, files: RunFiles, progress: Progress, time_limit_s: float | None
    ) -> None:
        analysis = prepare(
            model, progress, threads=self.threads, linear=self.linear, tolerance=self.tolerance
        )
        started = time.monotonic()

        def visit(running: Analysis, snapshot: Snapshot) -> None:
            files.step(running, snapshot)
            if time_limit_s is not None and time.monotonic() - started > time_limit_s:
                reached = snapshot.state.time
                raise SolveError(
                    f"the reference solver was stopped after {time_limit_s:g} s, at time {reached:g}",
                    where=str(files.folder / LOG_FILE),
                    fix="give more time with --time-limit-s, or use --element tet4",
                    time_reached=snapshot.state.time,
                )

        try:
            analysis.run(visit)
            files.finish(analysis, time.monotonic() - started)
        finally:
            analysis.close()

    def read(self, feb: Path) -> Simulation:
        """What a finished run left beside its model file."""
        outline = read_outline(feb)
        path = feb.parent / LOG_FILE
        log = read_log(path)
        check_complete(log, path, end_time=outline.end_time)
        tables = read_tables(outline, feb.parent)
        return Simulation(
            solver=self.name,
            version=log.version,
            times=tables.times,
            rigid=tables.rigid,
            nodes=tables.nodes,
            elements=tables.elements,
            n_iterations=log.n_iterations,
            n_factorisations=log.n_reformations,
            seconds=log.seconds,
            linear_solver=log.linear_solver,
        )


def prepare(
    model: LimbModel,
    progress: Progress = SILENT,
    *,
    threads: int = 2,
    linear: str = "auto",
    tolerance: float = 1e-6,
) -> Analysis:
    """An analysis of a model, after checking that all of it is supported."""
    from limbcli.fem.supported import check_supported, warm_up

    check_supported(model)
    warm_up(progress)
    from limbcli.fem.analysis import Analysis
    from limbcli.fem.newton import Settings

    if not model.contacts:
        tolerance = min(tolerance, _SMOOTH_TOLERANCE)
    return Analysis(model, Settings(tolerance=tolerance, linear=linear, threads=threads), progress)


# ---------------------------------------------------------------- session


@dataclass(frozen=True, eq=False)
class MustPoints:
    """The levels: times (s), depths (mm, positive down) and probe forces (N, compression positive)."""

    times: Array
    depths: Array
    forces: Array


@dataclass(frozen=True, eq=False)
class SessionResult:
    """One solve.

    force_gradient : d(force)/d(parameter) at the must-points, by (material, parameter)
    differenced : the gradients are central differences of whole solves, because the response
        depends on the way the load went (viscoelastic law, augmented contact)
    """

    simulation: Simulation
    must_points: MustPoints
    force_gradient: Mapping[Parameter, Array] = field(default_factory=dict)
    differenced: bool = False


class ReferenceSession:
    """A model kept in memory, to be solved again and again with other material parameters.

    Every solve starts from the converged levels of the one before, moved along their
    derivatives where these are known.

    body : whose force is meant; by default the body of the first contact
    """

    def __init__(
        self,
        model: LimbModel,
        *,
        progress: Progress = SILENT,
        threads: int = 2,
        linear: str = "auto",
        tolerance: float = 1e-6,
        body: str | None = None,
    ):
        self.model = model
        self.progress = progress
        self._analysis = prepare(model, progress, threads=threads, linear=linear, tolerance=tolerance)
        self.body = body or _contact_body(model)
        self._states: dict[float, State] = {}
        self._slopes: dict[float, dict[Parameter, Array]] = {}
        self._weights: Mapping[Parameter, Array] = {}

    def solve(
        self,
        model2: LimbModel | None = None,
        *,
        wrt: Sequence[Parameter] = (),
        weights: Mapping[Parameter, Array] | None = None,
        records: bool = False,
    ) -> SessionResult:
        """Solve the model, or `model2`: the same mesh and load with other material parameters.

        wrt : (material, parameter) pairs, such as ("tissue", "c1"), to differentiate by
        weights : for those of `wrt` that are maps, how much each cell's value (n_cells,) moves when
            theta moves by 1: their derivative is by theta
        records : also fill the node and element tables that the model asks for

        Raises
        ------
        SolveError
            If a level is not reached; the session can be used further.
        """
        from limbcli.fem import sensitivity
        from limbcli.fem.fields import record_rows

        model = model2 if model2 is not None else self.model
        if wrt and path_dependent(model):
            return self._differenced(model, wrt, records)
        guesses = self._guesses(model)
        moved = dict(weights or {})
        self._analysis.model = model
        started = time.monotonic()
        asked = self._records(model, records)
        rows: dict[str, list[tuple[IntArray, Array]]] = {r.file: [] for r in asked}
        gradients: dict[Parameter, list[float]] = {tuple(each): [] for each in wrt}  # type: ignore[misc]
        slopes: dict[float, dict[Parameter, Array]] = {}

        def visit(running: Analysis, snapshot: Snapshot) -> None:
            system, state = running.system, snapshot.state
            for record in asked:
                rows[record.file].append(record_rows(system, state, snapshot.forces, record))
            if gradients and snapshot.must:
                pairs: list[sensitivity.Parameter] = [
                    sensitivity.LawParameter(*each, weights=moved.get(each)) for each in gradients
                ]
                found = sensitivity.sensitivities(running.newton, state, snapshot.forces, pairs)
                b = [body.name for body in system.bodies].index(self.body)
                for name, each in zip(gradients, found, strict=True):
                    gradients[name].append(-float(each.bodies[b, 2]))
                    slopes.setdefault(state.time, {})[name] = each.displacement

        snapshots = self._analysis.run(visit, guesses=guesses)
        self.model = model
        self._states = {s.state.time: s.state for s in snapshots if s.must}
        self._slopes, self._weights = slopes, moved
        simulation = self._simulation(snapshots, asked, rows, time.monotonic() - started)
        must = np.array([s.must for s in snapshots])
        points = MustPoints(
            simulation.times[must],
            simulation.probe_depth(self.body)[must],
            simulation.probe_force(self.body)[must],
        )
        return SessionResult(simulation, points, {k: np.array(v) for k, v in gradients.items()})

    def close(self) -> None:
        self._analysis.close()

    def _differenced(self, model: LimbModel, wrt: Sequence[Parameter], records: bool) -> SessionResult:
        """The solve, with gradients by central differences of 1e-3 of each parameter."""
        gradients: dict[Parameter, Array] = {}
        for name in wrt:
            forces = []
            for sign in (1.0, -1.0):
                changed, step = _nudged(model, name, sign * _DIFFERENCE)
                forces.append(self.solve(changed).must_points.forces)
            gradients[tuple(name)] = (forces[0] - forces[1]) / (2 * step)  # type: ignore[index]
        return replace(self.solve(model, records=records), force_gradient=gradients, differenced=True)

    def _records(self, model: LimbModel, everything: bool) -> list[LogRecord]:
        from limbcli.fem.fields import BODY_FIELDS

        others = [r for r in model.records if everything and r.kind != "rigid_body"]
        rigid = [LogRecord("rigid_body", BODY_FIELDS, f"*{body.name}", body.name) for body in model.bodies]
        return rigid + others

    def _simulation(
        self,
        snapshots: list[Snapshot],
        asked: list[LogRecord],
        rows: dict[str, list[tuple[IntArray, Array]]],
        seconds: float,
    ) -> Simulation:
        times = np.array([s.state.time for s in snapshots])
        tables: dict[str, dict[str, Table]] = {"rigid_body": {}, "node": {}, "element": {}}
        for record in asked:
            key = str(record.items) if record.kind == "rigid_body" else record.file
            values = np.stack([each for _, each in rows[record.file]])
            items = np.zeros(1, dtype=np.int64) if record.kind == "rigid_body" else rows[record.file][0][0]
            tables[record.kind][key] = Table(record.fields, times, items, values)
        counts = self._analysis.totals()
        return Simulation(
            solver=NAME,
            version=limbcli.__version__,
            times=times,
            rigid=tables["rigid_body"],
            nodes=tables["node"],
            elements=tables["element"],
            n_iterations=counts.iterations,
            n_factorisations=counts.factorisations,
            seconds=seconds,
            linear_solver=self._analysis.newton.linear_name,
        )

    def _guesses(self, model: LimbModel) -> dict[float, State]:
        """Converged levels of the last solve, moved along their derivatives."""
        out = {}
        for when, state in self._states.items():
            u = state.u
            for (material, name), slope in self._slopes.get(when, {}).items():
                before = self.model.materials[material].parameters.get(name)
                after = model.materials[material].parameters.get(name)
                step = _theta_step(before, after, self._weights.get((material, name)))
                if step != 0.0:
                    u = u + step * slope
            out[when] = replace(state, u=u)
        return out


def _theta_step(before: object, after: object, weights: Array | None) -> float:
    """How far theta went from one value of a parameter to another; 0 where that is not known."""
    if isinstance(before, float | int) and isinstance(after, float | int):
        return float(after - before)
    if weights is None or not isinstance(before, ElementMap) or not isinstance(after, ElementMap):
        return 0.0
    step = float(weights @ (after.values - before.values) / (weights @ weights))
    return step if np.allclose(after.values, before.values + step * weights, rtol=1e-9) else 0.0


def path_dependent(model: LimbModel) -> bool:
    """Whether the response depends on the way to a load, not on the load alone."""
    laws = (material.law for material in model.materials.values())
    return "viscoelastic" in laws or any(contact.augmented for contact in model.contacts)


def _nudged(model: LimbModel, name: Parameter, relative: float) -> tuple[LimbModel, float]:
    """The model with one parameter moved by a part of itself, and by how much (unsigned)."""
    material = model.materials[name[0]]
    owner = material
    while name[1] not in owner.parameters and len(owner.parts) == 1:
        owner = owner.parts[0]
    value = owner.parameters.get(name[1])
    if not isinstance(value, float | int) or value == 0:
        raise SolveError(
            f"{name[0]}.{name[1]} cannot be differenced: it is {value!r}",
            where="derivative of a path-dependent response",
            fix="choose a parameter that is a number other than 0",
        )
    moved = owner.with_parameters(**{name[1]: value * (1 + relative)})
    if owner is not material:
        moved = replace(material, parts=(moved,))
    return model.with_material(name[0], moved), abs(value * relative)


def _contact_body(model: LimbModel) -> str:
    """The body that the first contact pushes with, else the first body."""
    names = [body.name for body in model.bodies]
    if not names:
        raise SolveError("the model has no rigid body", where="session", fix="add the probe")
    for contact in model.contacts:
        surface = model.mesh.surfaces[contact.secondary]
        nodes = np.concatenate([facets.ravel() for facets in surface.facets.values()])
        for body in model.bodies:
            blocks = [model.mesh.block(name).cells.ravel() for name in body.blocks]
            if blocks and np.isin(nodes, np.concatenate(blocks)).all():
                return body.name
    return names[0]
