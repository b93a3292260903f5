"""A model kept in memory: solved again with other parameters from where it was, with exact
derivatives of the probe's force.
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
from limbcli.model import Array, LimbModel, LogRecord
from limbcli.progress import SILENT, Progress
from limbcli.solvers.base import Simulation, Table
from limbcli.solvers.reference import NAME, prepare
from limbcli.solvers.session_models import check_same_set_up
from limbcli.solvers.session_parameters import (
    Parameter,
    check_materials,
    law_parameter,
    nudged,
    parameter_values,
)
from limbcli.solvers.session_watch import Rows, StateObserver, is_requested, key_of
from limbcli.version import __version__

if TYPE_CHECKING:
    from limbcli.fem.analysis import Snapshot
    from limbcli.fem.motion.state import State
    from limbcli.fem.other_mesh import OtherMesh
    from limbcli.fem.system import System
    from limbcli.fem.warm_start import Solved, WarmStart

_BODY_FILE = "*{}"  # the name of a body's record
_DIFFERENCE = 1e-3  # of a parameter, for responses that cannot be differentiated exactly


@dataclass(frozen=True, eq=False)
class MustPoints:
    """The levels: times (s), depths (mm, positive down) and probe forces (N, compression positive)."""

    times: Array
    depths: Array
    forces: Array


@dataclass(frozen=True, eq=False)
class SessionResult:
    """One solve.

    Attributes
    ----------
    simulation : every converged step, and the tables that were asked for
    must_points : times, depths and forces at the levels
    force_gradient : d(force)/d(parameter) at the must-points, by (material, parameter)
    field_gradient : d(field)/d(parameter) there, tables by record file (of bodies by name), if asked for
    levels : the states at the levels, which other solves may start from
    differenced : the gradients are central differences of whole solves, because the response
        depends on the way the load went (viscoelastic law, friction, augmented contact, a step that is
        defined from the end of the one before)
    """

    simulation: Simulation
    must_points: MustPoints
    force_gradient: Mapping[Parameter, Array] = field(default_factory=dict)
    differenced: bool = False
    field_gradient: Mapping[Parameter, Mapping[str, Table]] = field(default_factory=dict)
    levels: Solved | None = None


class ReferenceSession:
    """A model kept in memory, to be solved again and again with other material parameters.

    Every solve starts from the converged levels of the nearest one before, moved along their
    derivatives where these are known. A `with` block closes it.

    Parameters
    ----------
    model : its mesh (points (n_points, 3) in mm), laws (MPa), contact and load
    progress : where "newton" events go; `Progress(f)` calls f(kind, facts)
    threads : of the linear solver
    linear : "auto", or one of the direct solvers by name
    tolerance : residual over the forces at play, at which a level has converged
    stalled : residual that will do where iterations no longer lessen it; 0: none beyond the tolerance,
        or with friction a hundred times it
    body : whose force is meant; by default the body of the first contact

    Raises
    ------
    SolveError
        If the model holds what the reference solver does not support, or has no rigid body, or none of
        that name.

    Source: total Lagrangian elements and penalty contact, as the FEBio theory manual 4 describes them.
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
        required: int | None = None,
        hoped: int | None = None,
        last: int | None = None,
        patient: bool = True,
        leads: bool = True,
        enough_force: float | None = None,
        afresh: bool = False,
        led_by: Solved | None = None,
    ) -> SessionResult:
        """Solve the model, or `model2`: the same mesh, contact and supports with other materials and curves.

        Parameters
        ----------
        model2 : None: the model as it is
        wrt : (material, parameter) pairs, such as ("tissue", "c1"), to differentiate by; ("tissue",
            "m1-m2") is m1 and m2 together, the one up and the other down
        weights : for those of `wrt` that are maps, how much each cell's value (n_cells,) moves when
            theta moves by 1, and for a prestrain's "F0" each of its nine numbers: their derivative is by
            theta
        records : also fill the node and element tables that the model asks for
        field_gradients : fill them, and differentiate all that they hold by `wrt`, or those of these files
        required : how many levels must be reached, the rest as far as the solver gets; None: all
        hoped : how many are worth the full effort, later ones are tried briefly; None: those required
        last : how many are tried at all; None: all
        patient : where Newton's method fails, let the tissue come to rest, which takes long
        leads : later solves may start from its levels
        afresh : nothing of earlier solves is used but the levels of those that lead: the result does not
            depend on what else was solved
        enough_force : N on the body, at which the levels are enough; None: all are solved
        led_by : start from these levels, not from those of the nearest solve that leads

        Raises
        ------
        CaseError
            If `model2` differs in more.
        SolveError
            If a level is not reached, or `model2` holds what is not supported; the session can be used
            further.
        """
        from limbcli.fem.supported import check_supported, refuse_limp
        from limbcli.fem.warm_start import Solved, WarmStart

        model = model2 if model2 is not None else self.model
        check_same_set_up(self.model, model)
        if model is not self.model:
            check_supported(model)
            refuse_limp(model)
        check_materials(wrt, model)
        if wrt and path_dependent(model):
            return self._differenced(
                model, wrt, weights or {}, field_gradients, records=records, required=required, last=last,
                leads=leads, enough_force=enough_force, led_by=led_by, hoped=hoped, patient=patient,
                afresh=afresh,
            )  # fmt: skip
        moved = dict(weights or {})
        self._analysis.model = model
        values = parameter_values(model, wrt, moved)
        self._warm = self._warm or WarmStart()
        led = self._warm if led_by is None else WarmStart.by(led_by)
        led.at(values)
        if afresh:
            self._analysis.forget()
        started = time.monotonic()
        requested = self._records(model, records or bool(field_gradients))
        parameters = {(each[0], each[1]): law_parameter(each, moved.get(each), model) for each in wrt}
        watch = StateObserver(requested, parameters, self.body, of_fields=field_gradients)
        snapshots = self._analysis.run(
            watch, guesses=partial(self._guess, led), required=required, hoped=hoped, last=last,
            patient=patient,
            ends=None if enough_force is None else lambda: watch.force() >= enough_force,
        )  # fmt: skip
        self.model = model
        levels = Solved(
            values,
            {s.state.time: s.state for s in snapshots if s.must},
            watch.slopes,
            tuple(o.lame for o in self._analysis.system.operands),
        )
        if leads:
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
    def led(self) -> Solved | None:
        """The levels of the last solve that leads."""
        return self._warm.last if self._warm is not None else None

    def lead(self, solved: Solved) -> None:
        """Take levels that an earlier session kept as those of a solve of this one."""
        from limbcli.fem.warm_start import WarmStart

        self._warm = self._warm or WarmStart()
        self._warm.keep(solved)

    def begin_beside(self, other: LimbModel, displacements: Mapping[float, Array]) -> None:
        """Take first guesses from another mesh of the same body, where no earlier solve of this one has any.

        A mesh of other cells than tetrahedra leads nowhere.

        displacements : mm (n_points, 3) of the other model's nodes, by this model's times (s)

        Raises
        ------
        CaseError
            If displacements are not those of the other model's nodes.
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
        """Take first guesses from another session's levels so far, where its model has the same nodes."""
        same = self.model.mesh.points.shape == other.model.mesh.points.shape
        if same and len(self.model.bodies) == len(other.model.bodies):
            self._warm = copy(other._warm)

    def close(self) -> None:
        """Free the factors of the matrix and its threads."""
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
        *,
        records: bool,
        last: int | None,
        leads: bool,
        enough_force: float | None,
        led_by: Solved | None,
        **options: Any,
    ) -> SessionResult:
        """The solve, with gradients by central differences of 1e-3 of each parameter.

        Its levels are those that all of the solves reached.
        """
        found = self.solve(
            model, records=records or bool(fields), last=last, leads=leads, enough_force=enough_force,
            led_by=led_by, **options,
        )  # fmt: skip
        n = len(found.must_points.times)
        ends: dict[Parameter, tuple[SessionResult, SessionResult, float]] = {}
        try:
            for name in wrt:
                pair = []
                for sign in (1.0, -1.0):
                    changed, step = nudged(model, name, sign * _DIFFERENCE, along=weights.get(name))
                    pair.append(
                        self.solve(
                            changed, records=bool(fields), last=n, leads=False, led_by=found.levels, **options
                        )
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
        self,
        snapshots: list[Snapshot],
        requested: list[LogRecord],
        rows: dict[str, Rows],
        seconds: float,
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

    def _guess(self, led: WarmStart, system: System, time: float) -> State | None:
        found = led.guess(system, time)
        if found is None and self._other is not None:
            found = self._other.guess(system, time)
        return found


def _table_differences(
    up: SessionResult, down: SessionResult, width: float, times: Array, files: bool | Collection[str]
) -> dict[str, Table]:
    """Differences of the tables of `files` at the levels' times, over `width`."""
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
    """Whether the response depends on the way to a load, not on the load alone."""
    viscoelastic = any(each.is_viscoelastic for each in model.materials.values())
    by_the_way = viscoelastic or model.has_friction or any(each.augmented for each in model.contacts)
    return by_the_way or model.goes_on_from_steps


def _named_body(model: LimbModel, name: str) -> str:
    names = [body.name for body in model.bodies]
    if name not in names:
        raise SolveError(
            f"the model has no rigid body {name!r}", where="session", fix=f"use one of {', '.join(names)}"
        )
    return name


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
