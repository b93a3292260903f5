"""Sessions: a model kept in memory and solved repeatedly with other parameters.

Each solve starts from previous solutions and can return exact derivatives of the probe's force.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from limbcli.errors import CaseError, SolveError
from limbcli.model import Array, IntArray, LimbModel, LogRecord
from limbcli.progress import SILENT, Progress
from limbcli.solvers.reference import NAME, prepare
from limbcli.solvers.session_models import check_same_set_up
from limbcli.solvers.session_options import StartFrom, StopWhen
from limbcli.solvers.session_parameters import (
    Parameter,
    check_materials,
    law_parameter,
    nudged,
    parameter_values,
)
from limbcli.solvers.session_watch import Rows, StateObserver, is_requested, key_of
from limbcli.solvers.solver import Simulation, Table
from limbcli.version import __version__

if TYPE_CHECKING:
    from limbcli.fem.analysis import Snapshot
    from limbcli.fem.motion.state import State
    from limbcli.fem.other_mesh import OtherMesh
    from limbcli.fem.system import System
    from limbcli.fem.warm_start import Solved as Solved
    from limbcli.fem.warm_start import WarmStart

_BODY_FILE = "*{}"  # internal file name of a body's record
_DIFFERENCE = 1e-3  # relative parameter step of central differences, for path-dependent responses


@dataclass(frozen=True, eq=False)
class MustPoints:
    """The converged levels: times (s), depths (mm, positive down), probe forces (N, compression positive)."""

    times: Array
    depths: Array
    forces: Array


@dataclass(frozen=True, eq=False)
class SessionResult:
    """The result of one solve.

    Attributes
    ----------
    simulation : all converged steps, and the requested tables
    must_points : times, depths and forces at the levels
    force_gradient : d(force)/d(parameter) at the must-points, by (material, parameter)
    differenced : whether the gradients are central differences of whole solves, because the response is
        path-dependent (viscoelastic law, friction, augmented contact, a step defined relative to the end of
        the previous one), or because pressures are constant in each cell
    field_gradient : d(field)/d(parameter) there, if requested: tables by record file, or by name of the body
    levels : the states at the levels, as initial guesses for other solves
    """

    simulation: Simulation
    must_points: MustPoints
    force_gradient: Mapping[Parameter, Array] = field(default_factory=dict)
    differenced: bool = False
    field_gradient: Mapping[Parameter, Mapping[str, Table]] = field(default_factory=dict)
    levels: Solved | None = None

    @property
    def rows(self) -> IntArray:
        """Numbers of the levels (n_levels,) among the converged times."""
        times = self.simulation.times[None] - self.must_points.times[:, None]
        return np.asarray(np.abs(times).argmin(axis=1))


class ReferenceSession:
    """A model kept in memory, to be solved repeatedly with other material parameters.

    Every solve starts from the converged levels of the previous solve with the nearest parameter values,
    extrapolated linearly where their derivatives are known. Also a context manager that closes the session.

    Parameters
    ----------
    model : mesh (points (n_points, 3) in mm), laws (MPa), contact and load
    progress : receives "newton" events; `Progress(f)` calls f(kind, facts)
    threads : number of threads of the solver
    linear : "auto", or the name of a direct solver
    tolerance : relative residual (over the norm of the acting forces) at which a level has converged
    stalled : relative residual accepted where the iteration stagnates; 0: the tolerance, or with friction
        a hundred times the tolerance
    body : rigid body whose force is reported; by default that of the first contact

    Raises
    ------
    SolveError
        If the model uses features that the reference solver does not support, or has no rigid body, or
        none of that name.

    Source: total Lagrangian elements and penalty contact, as described in the FEBio Theory Manual 4.
    """

    def __init__(
        self,
        model: LimbModel,
        *,
        progress: Progress = SILENT,
        threads: int = 2,
        linear: str = "auto",
        tolerance: float = 1e-6,
        stalled: float = 0.0,
        body: str | None = None,
    ):
        self.model = model
        self.progress = progress
        self._analysis = prepare(
            model, progress, threads=threads, linear=linear, tolerance=tolerance, stalled=stalled
        )
        self.body = _contact_body(model) if body is None else _named_body(model, body)
        self._warm: WarmStart | None = None
        self._other: OtherMesh | None = None

    def solve(
        self,
        model2: LimbModel | None = None,
        *,
        wrt: Sequence[Parameter] = (),
        weights: Mapping[Parameter, Array] | None = None,
        records: bool = False,
        field_gradients: bool | Collection[str] = False,
        stop: StopWhen = StopWhen(),
        start: StartFrom = StartFrom(),
        keep_levels: bool = True,
    ) -> SessionResult:
        """Solve the model, or `model2` with the same mesh, contact and supports.

        Parameters
        ----------
        model2 : variant in materials, load curves, steps and records; None: the session's current model
        wrt : (material, parameter) pairs to differentiate by, such as ("tissue", "c1"); ("tissue", "m1-m2")
            increases m1 and decreases m2 together
        weights : for element maps in `wrt`, the change of each cell's value (n_cells,) per unit of theta; for
            a prestrain's "F0", that of its nine numbers. The derivative is with respect to theta
        records : also fill the node and element tables that the model requests
        field_gradients : fill these tables and differentiate their fields by `wrt`; True for all, or the
            record files to differentiate
        stop, start : when the solve ends, and where it takes its initial guesses from
        keep_levels : keep the levels as initial guesses for later solves

        Raises
        ------
        CaseError
            If `model2` differs in anything else.
        SolveError
            If a level is not reached, or `model2` uses an unsupported feature; the session remains usable.
            `BudgetSpent` if its budget is spent before the required levels are reached.
        """
        from limbcli.fem.analysis import RunEnd
        from limbcli.fem.elements.groups import differs_from_pointwise
        from limbcli.fem.supported import check_supported, refuse_without_stiffness
        from limbcli.fem.warm_start import Solved, WarmStart

        model = model2 if model2 is not None else self.model
        check_same_set_up(self.model, model)
        if model is not self.model:
            check_supported(model)
            refuse_without_stiffness(model)
        moved = dict(weights or {})
        check_materials(wrt, model)
        if wrt and (path_dependent(model) or differs_from_pointwise(model)):
            return self._differenced(
                model, wrt, moved, field_gradients, stop, records=records, start=start,
                keep_levels=keep_levels,
            )  # fmt: skip
        self._analysis.model = model
        values = parameter_values(model, wrt, moved)
        self._warm = self._warm or WarmStart()
        warm = self._warm if start.levels is None else WarmStart(start.levels)
        warm.at(values)
        if start.independent:
            self._analysis.forget()
        started = time.monotonic()
        requested = self._records(model, records or bool(field_gradients))
        parameters = {(each[0], each[1]): law_parameter(each, moved.get(each), model) for each in wrt}
        watch = StateObserver(requested, parameters, self.body, of_fields=field_gradients)
        enough = stop.enough_force
        end = RunEnd(
            required=stop.required, full_effort=stop.full_effort, last=stop.last, patient=stop.patient,
            reached=None if enough is None else lambda: watch.force() >= enough, limit=stop.budget,
        )  # fmt: skip
        snapshots = self._analysis.run(watch, guesses=partial(self._guess, warm), end=end)
        self.model = model
        levels = Solved(
            values,
            {s.state.time: s.state for s in snapshots if s.must},
            watch.slopes,
            tuple(o.lame for o in self._analysis.system.operands),
        )
        if keep_levels:
            self._warm.keep(levels)
        simulation = self._simulation(snapshots, requested, watch.rows, time.monotonic() - started)
        must = np.array([s.must for s in snapshots])
        points = MustPoints(
            simulation.times[must],
            simulation.probe_depth(self.body)[must],
            simulation.probe_force(self.body)[must],
        )
        gradients = {name: np.array(each) for name, each in watch.forces.items()}
        return SessionResult(
            simulation, points, gradients, field_gradient=watch.field_gradient(), levels=levels
        )

    @property
    def kept_levels(self) -> Solved | None:
        """The levels of the last solve with `keep_levels`; None if there is none."""
        return self._warm.last if self._warm is not None else None

    def nearest_levels(self, model: LimbModel) -> Solved | None:
        """The kept levels whose parameter values are nearest to this model's; None if none is kept."""
        return self._warm.nearest(parameter_values(model, (), {})) if self._warm is not None else None

    def lead(self, solved: Solved) -> None:
        """Add levels of an earlier session to the initial guesses of this one."""
        from limbcli.fem.warm_start import WarmStart

        self._warm = self._warm or WarmStart()
        self._warm.keep(solved)

    def begin_beside(self, other: LimbModel, displacements: Mapping[float, Array]) -> None:
        """Use a solution on another mesh of the same body for initial guesses where no earlier solve has any.

        A mesh of cells other than tetrahedra is ignored.

        displacements : nodal displacements (n_points, 3), mm, of the other model, by this model's times (s)

        Raises
        ------
        CaseError
            If the displacements do not have the shape of the other model's nodes.
        """
        from limbcli.fem.other_mesh import OtherMesh

        expected = other.mesh.points.shape
        for at, u in displacements.items():
            if np.shape(u) != expected:
                raise CaseError(
                    f"displacements {np.shape(u)} at {at:g} s, of a mesh whose nodes are {expected}",
                    where="session", fix="give three numbers for every node of the other model",
                )  # fmt: skip
        self._other = OtherMesh.of(other, displacements)

    def start_like(self, other: ReferenceSession) -> None:
        """Use another session's levels as initial guesses, if its model has as many nodes and bodies."""
        same = self.model.mesh.points.shape == other.model.mesh.points.shape
        if same and len(self.model.bodies) == len(other.model.bodies):
            self._warm = copy(other._warm)

    def close(self) -> None:
        """Release the matrix factor and the solver's threads."""
        self._analysis.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _differenced(
        self,
        model: LimbModel,
        wrt: Sequence[Parameter],
        weights: Mapping[Parameter, Array],
        fields: bool | Collection[str],
        stop: StopWhen,
        **options: Any,
    ) -> SessionResult:
        """A solve with gradients by central differences with a relative parameter step of 1e-3.

        The result is limited to the levels that all of the solves reached.

        options : of the solve of the model itself
        """
        options["records"] = options["records"] or bool(fields)
        found = self.solve(model, stop=stop, **options)
        beside = replace(options["start"], levels=found.levels)
        n = len(found.must_points.times)
        ends: dict[Parameter, tuple[SessionResult, SessionResult, float]] = {}
        try:
            for name in wrt:
                pair = []
                for sign in (1.0, -1.0):
                    changed, step = nudged(model, name, sign * _DIFFERENCE, along=weights.get(name))
                    reach = replace(stop, last=n, enough_force=None)
                    pair.append(
                        self.solve(changed, records=bool(fields), stop=reach, start=beside, keep_levels=False)
                    )
                    n = min(n, len(pair[-1].must_points.times))
                ends[name[0], name[1]] = (pair[0], pair[1], 2 * step)
        finally:
            self.model = model
        must = found.must_points
        gradients = {
            name: (up.must_points.forces[:n] - down.must_points.forces[:n]) / width
            for name, (up, down, width) in ends.items()
        }
        tables = {
            name: _table_differences(up, down, width, must.times[:n], fields) if fields else {}
            for name, (up, down, width) in ends.items()
        }
        return replace(
            found, force_gradient=gradients, field_gradient=tables, differenced=True,
            must_points=MustPoints(must.times[:n], must.depths[:n], must.forces[:n]),
        )  # fmt: skip

    def _records(self, model: LimbModel, everything: bool) -> list[LogRecord]:
        from limbcli.fem.record_fields import BODY_FIELDS

        others = [r for r in model.records if everything and r.kind != "rigid_body"]
        rigid = [
            LogRecord("rigid_body", BODY_FIELDS, _BODY_FILE.format(body.name), body.name)
            for body in model.bodies
        ]
        return rigid + others

    def _simulation(
        self, snapshots: list[Snapshot], requested: list[LogRecord], rows: dict[str, Rows], seconds: float
    ) -> Simulation:
        times = np.array([s.state.time for s in snapshots])
        tables: dict[str, dict[str, Table]] = {"rigid_body": {}, "node": {}, "element": {}}
        for record in requested:
            key = key_of(record)
            values = np.stack([each for _, each in rows[record.file]])
            items = np.zeros(1, dtype=np.int64) if record.kind == "rigid_body" else rows[record.file][0][0]
            tables[record.kind][key] = Table(record.fields, times, items, values)
        counts = self._analysis.totals()
        return Simulation(
            solver=NAME,
            version=__version__,
            times=times,
            rigid=tables["rigid_body"],
            nodes=tables["node"],
            elements=tables["element"],
            n_iterations=counts.iterations,
            n_factorisations=counts.factorisations,
            seconds=seconds,
            linear_solver=self._analysis.newton.linear_name,
        )

    def _guess(self, start: WarmStart, system: System, time: float) -> State | None:
        found = start.guess(system, time)
        if found is None and self._other is not None:
            found = self._other.guess(system, time)
        return found


def _table_differences(
    up: SessionResult, down: SessionResult, width: float, times: Array, files: bool | Collection[str]
) -> dict[str, Table]:
    """Difference quotients, over `width`, of the tables of `files` at the levels' times."""
    found: dict[str, Table] = {}
    for kind in ("rigid", "nodes", "elements"):
        for key, one in getattr(up.simulation, kind).items():
            if not is_requested(_BODY_FILE.format(key) if kind == "rigid" else key, files):
                continue
            other = getattr(down.simulation, kind)[key]
            mine, theirs = np.isin(one.times, times), np.isin(other.times, times)
            change = (one.values[mine] - other.values[theirs]) / width
            found[key] = Table(one.fields, one.times[mine], one.items, change)
    return found


def path_dependent(model: LimbModel) -> bool:
    """Whether the response depends on the loading path, not only on the load."""
    return model.remembers or model.goes_on_from_steps


def _named_body(model: LimbModel, name: str) -> str:
    names = [body.name for body in model.bodies]
    if name not in names:
        raise SolveError(
            f"the model has no rigid body {name!r}", where="session", fix=f"use one of {', '.join(names)}"
        )
    return name


def _contact_body(model: LimbModel) -> str:
    """The body whose blocks contain the first contact's secondary surface, else the first body."""
    names = [body.name for body in model.bodies]
    if not names:
        raise SolveError("the model has no rigid body", where="session", fix="add the probe")
    for contact in model.contacts:
        surface = model.mesh.surfaces[contact.secondary]
        nodes = np.concatenate([facets.ravel() for facets in surface.facets.values()])
        for body in model.bodies:
            if np.isin(nodes, model.mesh.nodes_of(body.blocks)).all():
                return body.name
    return names[0]
