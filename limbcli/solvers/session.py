"""A model kept in memory: solved again with other parameters from where it was, with exact
derivatives of the probe's force.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

import limbcli
from limbcli.errors import SolveError
from limbcli.model import Array, ElementMap, IntArray, LimbModel, LogRecord
from limbcli.progress import SILENT, Progress
from limbcli.solvers.base import Simulation, Table
from limbcli.solvers.reference import NAME, prepare

if TYPE_CHECKING:
    from limbcli.fem.analysis import Analysis, Snapshot
    from limbcli.fem.parameters import LawParameter, Prestrain, Tied
    from limbcli.fem.warm import WarmStart

_DIFFERENCE = 1e-3  # of a parameter, for responses that cannot be differentiated exactly
Parameter = tuple[str, str]


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
        depends on the way the load went (viscoelastic law, friction, augmented contact)
    """

    simulation: Simulation
    must_points: MustPoints
    force_gradient: Mapping[Parameter, Array] = field(default_factory=dict)
    differenced: bool = False


class ReferenceSession:
    """A model kept in memory, to be solved again and again with other material parameters.

    Every solve starts from the converged levels of the nearest one before, moved along their
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
        self._warm: WarmStart | None = None

    def solve(
        self,
        model2: LimbModel | None = None,
        *,
        wrt: Sequence[Parameter] = (),
        weights: Mapping[Parameter, Array] | None = None,
        records: bool = False,
    ) -> SessionResult:
        """Solve the model, or `model2`: the same mesh and load with other material parameters.

        wrt : (material, parameter) pairs, such as ("tissue", "c1"), to differentiate by; ("tissue",
            "m1-m2") is m1 and m2 together, the one up and the other down
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
        from limbcli.fem.warm import Solved

        model = model2 if model2 is not None else self.model
        if wrt and path_dependent(model):
            return self._differenced(model, wrt, records)
        moved = dict(weights or {})
        self._analysis.model = model
        warm = self._warm_start(model, wrt, moved)
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
                    _law_parameter(each, moved.get(each), model) for each in gradients
                ]
                found = sensitivity.sensitivities(running.newton, state, snapshot.forces, pairs)
                b = [body.name for body in system.bodies].index(self.body)
                for name, each in zip(gradients, found, strict=True):
                    gradients[name].append(-float(each.bodies[b, 2]))
                    slopes.setdefault(state.time, {})[name] = each.displacement

        snapshots = self._analysis.run(visit, guesses=warm.guess)
        self.model = model
        warm.keep(
            Solved(
                _values(model, wrt, moved),
                {s.state.time: s.state for s in snapshots if s.must},
                slopes,
                tuple(o.lame for o in self._analysis.system.operands),
            )
        )
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

    def _warm_start(
        self, model: LimbModel, wrt: Sequence[Parameter], weights: Mapping[Parameter, Array]
    ) -> WarmStart:
        from limbcli.fem.warm import WarmStart

        self._warm = self._warm or WarmStart()
        self._warm.at(_values(model, wrt, weights))
        return self._warm


def tied_parts(name: str) -> list[tuple[str, float]]:
    """The parameters behind a name, and how far each moves.

    >>> tied_parts("m1-m2"), tied_parts("0.c1")
    ([('m1', 1.0), ('m2', -1.0)], [('0.c1', 1.0)])
    """
    return [(part, -1.0 if sign == "-" else 1.0) for sign, part in re.findall(r"([+-]?)([^+-]+)", name)]


def _law_parameter(
    key: Parameter, weights: Array | None, model: LimbModel
) -> LawParameter | Tied | Prestrain:
    """What a key stands for; "ramp" of a prestrained material is its prestrain's."""
    from limbcli.fem.parameters import LawParameter, Prestrain, Tied

    material, name = key
    if name == "ramp" and model.materials[material].law == "prestrain":
        return Prestrain(material)
    parts = tied_parts(name)
    if len(parts) == 1:
        return LawParameter(material, name, weights=weights)
    return Tied(tuple((LawParameter(material, part, weights=weights), rate) for part, rate in parts))


def _values(
    model: LimbModel, wrt: Sequence[Parameter], weights: Mapping[Parameter, Array]
) -> dict[Parameter, float]:
    """Every number of the model's laws; of a map along `weights` its coefficient; of tied ones the first."""
    out: dict[Parameter, float] = {}
    for material, law in model.materials.items():
        for name, value in law.parameters.items():
            if isinstance(value, float | int):
                out[material, name] = float(value)
    for material, name in wrt:
        first = model.materials[material].parameters.get(tied_parts(name)[0][0])
        along = weights.get((material, name))
        if isinstance(first, float | int):
            out[material, name] = float(first)
        elif isinstance(first, ElementMap) and along is not None:
            out[material, name] = float(along @ first.values / (along @ along))
    return out


def path_dependent(model: LimbModel) -> bool:
    """Whether the response depends on the way to a load, not on the load alone."""
    laws = (material.law for material in model.materials.values())
    return "viscoelastic" in laws or any(each.augmented or each.friction for each in model.contacts)


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
