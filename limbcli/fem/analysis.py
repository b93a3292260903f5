"""The load, level by level: steps, must-points, first guesses, step cutting.

Without history (elastic law, no friction) the response depends on the load reached
and not on the way, so the levels are the must-points alone (or the steps, where a
step has none), and a step is cut only where Newton's method needs it. Friction is
measured over the steps of the model: these are all solved for, and strides within
one are first guesses. With a viscoelastic law every stride is a step of its history.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.guesses import continued, extrapolate
from limbcli.fem.history import Histories
from limbcli.fem.levels import step_times
from limbcli.fem.newton import Counts, Level, Newton, NotConverged, Settings
from limbcli.fem.singular import SingularMatrix
from limbcli.fem.state import Forces, State, norm
from limbcli.fem.system import System
from limbcli.model import LimbModel, Step
from limbcli.progress import SILENT, Progress

_MAX_CUTS = 8
_BRIEF_CUTS, _BRIEF_ITERATIONS = 2, 40  # of a level that is tried briefly
_SMALLEST = 1e-3  # of the nominal step: a stride below it is given up
# Residual at which a stride on the way is good enough, and once one was cut at the level: loose ones then
# lead nowhere, however short.
_LOOSE, _FIRM = 3e-2, 1e-3
_FIRST = 4.0  # of the model's step: the first stride, where the response does not depend on the way
_FAR_OUT = 3.0  # error of a first guess above which a stride is shortened untried
_FAR_OFF = 0.5  # the same for a guess from an earlier solve
_WARY = 5  # strides after a cut before they may grow again
_EASY = 4  # iterations up to which the next stride may be longer


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One converged time. must : it is a must-point, or the end of a step."""

    step: int
    state: State
    forces: Forces
    must: bool


Visitor = Callable[["Analysis", Snapshot], None]
Guesses = Callable[[System, float], State | None]


class Analysis:
    """Runs a model's steps; keeps system, factor and converged states for warm starts."""

    def __init__(self, model: LimbModel, settings: Settings | None = None, progress: Progress = SILENT):
        self.model = model
        self.settings = settings or Settings()
        self.progress = progress
        self.counts = Counts()
        self._newton: Newton | None = None
        self._supports: tuple[object, ...] | None = None
        self._stride = np.inf
        self._wary, self._cuts, self._brief = 0, 0, False
        self._n_touching = self._n_pressed = 0  # points that touched last; strides that ended in contact
        self._histories: Histories | None = None
        self._last_forces: Forces

    @property
    def remembers(self) -> bool:
        """Whether the response depends on the way the load went (viscoelastic materials, friction)."""
        return self._timed or self._rubbing

    @property
    def _rubbing(self) -> bool:
        """Whether there is friction: points that stick or slip by turns take their time to settle."""
        return any(contact.friction for contact in self.model.contacts)

    @property
    def _timed(self) -> bool:
        """Whether it depends on the length of every stride taken."""
        return any(material.law == "viscoelastic" for material in self.model.materials.values())

    @property
    def _marching(self) -> bool:
        """Whether strides are short steps that serve as first guesses only."""
        return bool(self.model.contacts) and not self._timed

    @property
    def newton(self) -> Newton:
        assert self._newton is not None
        return self._newton

    @property
    def system(self) -> System:
        return self.newton.system

    def run(
        self, visit: Visitor | None = None, *, guesses: Guesses | None = None, required: int | None = None,
        hoped: int | None = None,
    ) -> list[Snapshot]:  # fmt: skip
        """All steps from rest to the end; `visit` is called at every converged time.

        guesses : first guess at a time, from earlier runs of the same load, or None
        required : how many levels must be reached; where a later one fails the run ends with those before
            it. None: all
        hoped : how many are worth the full effort, later ones are tried briefly. None: those required
        """
        snapshots: list[Snapshot] = []
        state: State | None = None
        self._histories = None
        begin, n_must = 0.0, 0
        hoped = required if hoped is None else hoped
        n_levels = sum(len(step_times(step, every=self.remembers)) for step in self.model.steps)
        number = 0
        for step in self.model.steps:
            newton = self._prepare(step, state)
            state = newton.system.start
            reached: list[State] = [state]
            self._known: State | None = None
            self._n_touching = self._n_pressed = 0
            self._stride = _FIRST * step.step_size if self._marching else np.inf
            musts = {begin + t for t in step_times(step)}
            if self._histories is None and self.remembers:
                self._histories = Histories(newton.system)
            for target in step_times(step, every=self.remembers):
                number += 1
                level = Level(number, n_levels, self._depth(newton.system, begin + target))
                known = guesses(newton.system, begin + target) if guesses else None
                newton.system.remember(state)
                self._brief = hoped is not None and n_must >= hoped
                try:
                    state = self._reach(begin + target, step, reached, level, known)
                except SolveError:
                    if required is not None and n_must >= required:
                        return snapshots
                    raise
                must = begin + target in musts
                n_must += must
                snapshot = Snapshot(len(snapshots) + 1, state, self._last_forces, must)
                snapshots.append(snapshot)
                if visit is not None:
                    visit(self, snapshot)
            begin += step.n_steps * step.step_size
        return snapshots

    def _prepare(self, step: Step, state: State | None) -> Newton:
        """The system of a step: the one at hand, if its supports and drives are the same."""
        key = (*step.supports, *step.drives)
        if self._newton is not None and self._supports == key and state is None:
            system = self._newton.system
            system.with_materials(self.model)
            system.begin()
            return self._newton
        if self._newton is not None and self._supports == key and state is not None:
            self._newton.system.start = state
            return self._newton
        if self._newton is not None:
            self._collect()
            self._newton.close()
        system = System(
            self.model,
            supports=self.model.supports + step.supports,
            drives=self.model.drives + step.drives,
            threads=self.settings.threads,
            start=state,
        )
        self._newton = Newton(system, self.settings, self.progress)
        self._supports = key
        return self._newton

    def _reach(
        self,
        target: float,
        step: Step,
        reached: list[State],
        level: Level,
        known: State | None,
    ) -> State:
        """March to a time in strides that Newton's method can take.

        Strides on the way serve as first guesses only: they are solved loosely and not kept.
        """
        newton = self.newton
        cuts, self._cuts, start = 0, 0, (len(reached), self._n_pressed, self._n_touching)
        until = newton.counts.iterations + _BRIEF_ITERATIONS
        newton.mixed = self.settings.mixed
        while True:
            begin = reached[-1].time
            rest = target - begin
            n = 1 if known is not None else int(np.ceil(rest / self._stride - 1e-6))
            aim = target if n <= 1 else begin + rest / n
            last = cuts >= (_BRIEF_CUTS if self._brief else max(_MAX_CUTS, step.max_retries))
            before = newton.counts.iterations
            if self._brief and before > until:
                raise newton.failure(reached[-1], self._last_forces, level, before - until, "it takes long")
            try:
                patient = last or self._rubbing or newton.system.jumps
                state, forces = self._solve(aim, reached, level, known, aim == target, patient=patient)
                if aim == target:
                    state, forces = self._augmented(state, forces, level)
            except (NotConverged, SingularMatrix) as error:
                cuts += 1
                self._cuts += 1
                newton.counts.retries += 1
                if isinstance(error, SingularMatrix):
                    newton.linearised.inverse = None
                if last or aim - begin < _SMALLEST * step.step_size or _hopeless(error, reached):
                    if not newton.mixed or self.remembers or self._brief or _hopeless(error, reached):
                        raise _explained(error, level, aim, len(reached) - 1) from error
                    self._start_again(reached, *start)
                    cuts, aim, begin = 0, target, reached[-1].time
                self._stride = rest if known is not None else 0.5 * (aim - begin)
                self._wary = _WARY if known is None else 0
                known = None
                if newton.counts.iterations > before:  # else the factor is of the state to start from
                    newton.linearised.debt = np.inf
                newton.system.recall(reached[-1].hints)
                continue
            used = newton.counts.iterations - before
            cuts = 0
            easy = _EASY + (2 if aim == target else 0)
            self._wary = max(self._wary - 1, 0)
            if aim - begin >= 0.6 * self._stride and used <= easy and not self._wary:
                self._stride *= 2.0
            reached.append(state)
            self._n_touching = forces.n_touching
            self._n_pressed += int(forces.n_touching > 0)
            if self._histories is not None:
                self._histories.accept(aim - begin, state)
            if aim == target:
                self._last_forces = forces
                self._known = known
                return state

    def _start_again(self, reached: list[State], n_reached: int, n_pressed: int, n_touching: int) -> None:
        """Back to the last level, for a try without pressures of their own: they go further, but now and
        then astray."""
        self.newton.mixed = False
        del reached[n_reached:]
        self._n_pressed, self._n_touching = n_pressed, n_touching

    def _solve(
        self,
        time: float,
        reached: list[State],
        level: Level,
        known: State | None,
        must: bool,
        *,
        patient: bool,
    ) -> tuple[State, Forces]:
        newton = self.newton
        tolerance = None if must or self._timed else _FIRM if self._cuts else _LOOSE
        if self._histories is not None:
            self._histories.begin(time - reached[-1].time)
        guess, forces = self._guess(time, reached, level, known, patient)
        if known is not None:  # a level away from where the factor was made
            newton.linearised.debt = np.inf
        return newton.equilibrate(guess, level, forces=forces, tolerance=tolerance, patient=patient)

    def _guess(
        self, time: float, reached: list[State], level: Level, known: State | None, patient: bool
    ) -> tuple[State, Forces | None]:
        """The best of the first guesses there are; with the contact searched for it.

        From an earlier solve: its level as it is, and its increment added to the last level. Else on
        the line and on the parabola through the last states, or, where that leads nowhere, along the tangent.
        A stride whose guesses are all far out is refused at once, which is cheaper than to fail.
        """
        system = self.newton.system
        if known is not None:
            guesses = [system.prescribed(known, time)]
            if self._known is not None and len(reached) > 1 and reached[-1].time == self._known.time:
                guesses.append(system.prescribed(continued(system, reached[-1], self._known, known), time))
        else:
            # the unloaded state is of no use, nor are those in the air
            most = min(self._n_pressed if system.pairs else len(reached) - 1, 3)
            guesses = [extrapolate(system, reached[-n:], time) for n in range(2, most + 1)]
        limit = _FAR_OUT if known is None else _FAR_OFF
        error, guess, forces = self._best(guesses, time)
        if guess is None or (known is None and error > limit):
            error, guess, forces = self._best([self.newton.predict(reached[-1], time)], time)
        if guess is None or (error > limit and self._marching and not patient and len(reached) > 1):
            raise self.newton.failure(
                reached[-1], self._last_tried, level, 0, "the step is too long for a first guess"
            )
        return guess, forces

    def _best(self, guesses: list[State], time: float) -> tuple[float, State | None, Forces | None]:
        """The guess with the smallest error whose cells are sound, that error, and the forces there.

        The forces are left out where another guess was searched for contact after it.
        """
        newton, system = self.newton, self.newton.system
        system.at(time)
        best: tuple[float, State | None, Forces | None] = (np.inf, None, None)
        for each in guesses:
            system.recall(each.hints)
            found = self._last_tried = newton.forces(each)
            error = found.error
            if len(guesses) > 1:  # a guess that loses contact misleads
                error += max(1.0 - found.n_touching / max(self._n_touching, 1), 0.0)
            else:
                error = min(norm(found.mixed) / max(found.scale, 1e-14), error)
            if found.worst > 0 and error < best[0]:
                best = (error, each, found)
        guess = best[1]
        if guess is not None and guess is not guesses[-1]:
            system.recall(guess.hints)
            return best[0], guess, None
        return best

    def _augmented(self, state: State, forces: Forces, level: Level) -> tuple[State, Forces]:
        """Augmentations of the contact pressure until its multipliers settle."""
        for pair in self.system.pairs:
            if not pair.contact.augmented:
                continue
            most = int(float(pair.contact.more.get("maxaug", "10")))
            for _ in range(most):
                if pair.augment() <= pair.contact.tolerance:
                    break
                state, forces = self.newton.equilibrate(state, level)
        return state, forces

    def _depth(self, system: System, time: float) -> float:
        state = system.prescribed(system.start, time)
        depths = [-(body.center + at.shift)[2] for body, at in zip(system.bodies, state.bodies, strict=True)]
        return float(depths[0]) if depths else 0.0

    def _collect(self) -> None:
        """Counts of the Newton object, which starts anew: others hold on to them."""
        for name in ("iterations", "residuals", "krylov", "factorisations", "retries"):
            setattr(self.counts, name, getattr(self.counts, name) + getattr(self.newton.counts, name))
            setattr(self.newton.counts, name, 0)

    def totals(self) -> Counts:
        self._collect()
        return self.counts

    def close(self) -> None:
        if self._newton is not None:
            self._newton.close()


def _hopeless(error: SolveError, reached: list[State]) -> bool:
    """No factor of the unloaded tissue: shorter steps will not give one."""
    return isinstance(error, SingularMatrix) and len(reached) == 1 and reached[0].time == 0.0


def _explained(error: SolveError, level: Level, time: float, n_reached: int) -> SolveError:
    """The error with the level it belongs to."""
    if isinstance(error, NotConverged):
        return error
    cause = (
        "a part of the tissue, or a rigid body, can move freely"
        if n_reached == 0
        else "the tissue is losing its stability: a cell is about to turn inside out, or contact was lost"
    )
    place = f"load level {level.number} of {level.n_levels} (time {time:.6g}, depth {level.depth:.2f} mm)"
    return SolveError(
        f"{place}: {error.what}",
        where=f"{error.where}; {cause}",
        fix=error.fix if n_reached == 0 else "use more load steps; look at the mesh and the supports",
        level=level.number,
        depth=level.depth,
    )
