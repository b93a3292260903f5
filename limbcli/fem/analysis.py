"""Runs the load steps of a model: its analysis steps and must-points.

Without path dependence (elastic law, no friction) the response depends only on the load reached,
so only the must-points are solved for (or all time steps of an analysis step that has none), and
they are subdivided (see `load_stepping`) only where Newton's method requires it. Frictional slip is
measured over the model's time steps: all of these are solved for, and smaller increments only supply
initial guesses. With a viscoelastic law every increment is a time step of the stress history.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from limbcli.errors import SolveError
from limbcli.fem.equilibrium.history import Histories
from limbcli.fem.equilibrium.load_stepping import LoadStepping
from limbcli.fem.equilibrium.newton import Newton
from limbcli.fem.equilibrium.settings import Counts, Settings, WorkLimit, WorkMeter
from limbcli.fem.equilibrium.solve_times import counts_every_step, listed_times, step_times
from limbcli.fem.motion import load_curves
from limbcli.fem.motion.state import Forces, State
from limbcli.fem.system import System
from limbcli.model import LimbModel, Step
from limbcli.progress import SILENT, Progress


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One converged time.

    part, step : number of its analysis step (from 0), and of the time step within it (from 1)
    must, listed : whether it is a must-point or the end of an analysis step; a must-point
    """

    part: int
    step: int
    state: State
    forces: Forces
    must: bool
    listed: bool


@dataclass(frozen=True, kw_only=True)
class RunEnd:
    """How far a run goes, and with how much effort.

    required : number of must-points that have to be reached; if a later one fails, the run ends with
        the results so far. None: all
    full_effort : number of must-points solved with full effort; later ones are attempted with a small
        iteration budget. None: as `required`
    last : number of must-points attempted at all; None: all
    patient : where Newton's method fails before a required must-point, fall back on pseudo-time
        relaxation, which is slow
    reached : called after `visit` at every must-point; True ends the run
    limit : of the work of this run
    """

    required: int | None = None
    full_effort: int | None = None
    last: int | None = None
    patient: bool = True
    reached: Callable[[], bool] | None = None
    limit: WorkLimit | None = None


Visitor = Callable[["Analysis", Snapshot], None]
Guesses = Callable[[System, float], State | None]


class Analysis:
    """Runs a model's steps; keeps the system and its matrix factor for further runs."""

    def __init__(self, model: LimbModel, settings: Settings | None = None, progress: Progress = SILENT):
        self.model = model
        self.settings = settings or Settings()
        self.progress = progress
        self.counts = Counts()
        self._newton: Newton | None = None
        self._supports: tuple[object, ...] | None = None

    @property
    def newton(self) -> Newton:
        assert self._newton is not None
        return self._newton

    @property
    def system(self) -> System:
        return self.newton.system

    def run(
        self, visit: Visitor | None = None, *, guesses: Guesses | None = None, end: RunEnd = RunEnd()
    ) -> list[Snapshot]:
        """Run all steps from rest to the end; `visit` is called at every converged time.

        guesses : returns an initial guess at a time, from earlier runs of the same load, or None
        """
        required = end.required
        snapshots: list[Snapshot] = []
        state: State | None = None
        histories: Histories | None = None
        begin, n_must = 0.0, 0
        full_effort = required if end.full_effort is None else end.full_effort
        times = self.times()
        n_steps = sum(map(len, times))
        number = 0
        for part, targets in enumerate(times):
            step = self.model.steps[part]  # `visit` may have changed the model's later steps
            newton = self._prepare(step, state)
            state = newton.system.start
            musts = set(step_times(step, begin=begin) if step.must_points else targets)
            listed = listed_times(step, begin)
            if histories is not None:
                histories.system = newton.system
            elif self.model.remembers:
                histories = Histories(newton.system)
            meter = WorkMeter(newton.counts, end.limit)
            stepping = LoadStepping(self.model, step, newton, histories)
            for within, target in enumerate(targets, start=1):
                if end.last is not None and n_must >= end.last:
                    return snapshots
                number += 1
                load_step = newton.load_step(number, n_steps, target, meter)
                known = guesses(newton.system, target) if guesses else None
                newton.system.remember(state)
                advance = partial(
                    stepping.advance_to,
                    brief=full_effort is not None and n_must >= full_effort,
                    patient=end.patient and (required is None or n_must < required),
                )
                try:
                    if self.settings.slip_as_febio and self.model.has_friction:
                        # FEBio measures a time step from where its first iterate ends
                        newton.system.remember(newton.first_iterate(state, target))
                    state, forces = advance(target, load_step, known)
                except SolveError:
                    if required is not None and n_must >= required:
                        return snapshots
                    raise
                must = target in musts
                n_must += must
                snapshot = Snapshot(part, within, state, forces, must, target in listed)
                if snapshots:  # of many time steps, the state of all contact points would fill the memory
                    forces = snapshots[-1].forces
                    contact = replace(forces.contact, points=())
                    snapshots[-1] = replace(snapshots[-1], forces=replace(forces, contact=contact))
                snapshots.append(snapshot)
                if visit is not None:
                    visit(self, snapshot)
                if must and end.reached is not None and end.reached():
                    return snapshots
            begin = targets[-1]
        return snapshots

    def forget(self) -> None:
        """Discard the factor of earlier runs, which may change the last digits."""
        if self._newton is not None:
            self._collect()
            self._newton.linearised.forget()

    def times(self) -> list[list[float]]:
        """The times (s, of the whole analysis) to solve for in each step."""
        found, begin = [], 0.0
        for step in self.model.steps:
            curve = self.model.curves.get(step.dt_max_curve or "")
            largest = None if curve is None else partial(load_curves.value, curve)
            every = self.model.remembers or counts_every_step(step)
            found.append(step_times(step, begin=begin, every=every, largest=largest))
            begin = found[-1][-1]
        return found

    def _prepare(self, step: Step, state: State | None) -> Newton:
        """Prepare the system of a step; the current one is reused if its supports and drives are the same."""
        key = (*step.supports, *step.drives, *step.loads)
        if self._newton is not None and self._supports == key and state is None:
            system = self._newton.system
            system.with_materials(self.model)
            system.begin()
            return self._newton
        if self._newton is not None and self._supports == key and state is not None:
            self._newton.system.start = state
            return self._newton
        before = self._newton
        if before is not None:
            self._collect()
            before.close()
        # relative supports and drives start from the unloaded state
        supports = tuple(replace(each, relative=False) for each in self.model.supports)
        drives = tuple(replace(each, relative=False) for each in self.model.drives)
        system = System(
            self.model,
            supports=supports + step.supports,
            drives=drives + step.drives,
            loads=self.model.loads + step.loads,
            threads=self.settings.threads,
            start=state,
        )
        if before is not None and state is not None:
            system.take_multipliers(before.system)
        self._newton = Newton(system, self.settings, self.progress)
        self._supports = key
        return self._newton

    def _collect(self) -> None:
        """Add the Newton object's counts to the totals and reset them in place (the object is shared)."""
        for name in ("iterations", "residuals", "krylov", "factorisations", "retries"):
            setattr(self.counts, name, getattr(self.counts, name) + getattr(self.newton.counts, name))
            setattr(self.newton.counts, name, 0)

    def totals(self) -> Counts:
        self._collect()
        return self.counts

    def close(self) -> None:
        if self._newton is not None:
            self._newton.close()
