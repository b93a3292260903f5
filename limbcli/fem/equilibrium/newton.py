"""Equilibrium at one time: Newton's method with few factorisations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.equilibrium.linearised import Linearised
from limbcli.fem.equilibrium.settings import Counts, LoadStep, Settings
from limbcli.fem.equilibrium.stagnation import Stagnation
from limbcli.fem.motion.state import Forces, State, norm
from limbcli.fem.system import System
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

__all__ = ["Counts", "LoadStep", "Newton", "NotConverged", "Settings"]

_PATIENCE, _PATIENT_ITERATIONS = 10.0, 4
_ROUND_OFF = 1e-6  # of the least force: what no iteration takes away
_FORCING = (1e-4, 0.1)  # part of the residual that a step may leave: near equilibrium, far from it
_ROUGH = 0.1  # of the load's change: what a first guess may leave
_FAR = 0.1  # error from which on contact tractions are not yet what they will be
_NEARLY_FLAT = 0.4  # volume ratio of an element that is about to turn inside out
_SHARE = 0.6  # of what Newton's method leaves by itself


class NotConverged(SolveError):
    """Newton's method gave up at one time; the caller may cut the step."""


class Newton:
    """Equilibrium of one system; keeps its tangent and factor between times.

    nearest : the least error of the last try, at pressures of their own, and its state
    """

    def __init__(self, system: System, settings: Settings, progress: Progress = SILENT):
        self.system, self.settings, self.progress = system, settings, progress
        self.counts = Counts()
        self.linearised = Linearised(system, settings, self.counts)
        self.mixed = settings.mixed  # pressures of their own, now
        self.nearest: tuple[float, State | None] = (np.inf, None)

    @property
    def linear_name(self) -> str:
        linear = self.linearised.linear
        return str(linear.name) if linear is not None else "none"

    def forces(self, state: State) -> Forces:
        self.counts.residuals += 1
        return self.system.forces(state)

    def predict(self, state: State, time: float) -> State:
        """The state moved to `time` along the tangent: no element sees the whole step at once."""
        system, linearised = self.system, self.linearised
        system.at(time)
        forces = self.forces(replace(state, time=time, volumes=()))
        if linearised.is_outdated:
            linearised.refresh(state, forces.nodal)
        else:
            linearised.assemble(state, forces.nodal)
        aim = system.prescribed(state, time)
        v = np.where(system.free, 0.0, aim.u - state.u)
        motions = np.zeros((len(system.bodies), 6))
        for b in range(len(system.bodies)):
            motions[b, :3] = aim.bodies[b].shift - state.bodies[b].shift
        change = system.tangent_times(state, v) if v[system.coupled].any() else np.zeros_like(v)
        contact = system.contact_residual(state)
        tissue = forces.residual - contact
        tissue[: system.n_tissue] += change[system.free]
        rhs = tissue + contact + system.contact_change(state, motions=motions)
        first = linearised.solve(state, -rhs, _ROUGH)
        step = linearised.settle(aim, tissue, _ROUGH * norm(rhs), first=first, far=True)
        return self.with_volumes(system.moved(aim, step), state)

    def with_volumes(self, guess: State, state: State) -> State:
        """The guess with pressures that follow its step from `state` linearly.

        A step of the displacements changes the volumes in second order too; times the bulk stiffness
        that is a pressure far beyond those at play, and its tangent leads nowhere. So the tangent is
        taken at pressures of their own, which catch up as the iteration converges: Newton's method on
        displacements and pressures, the latter eliminated (Magisano, Leonetti and Garcea 2017, Comput.
        Methods Appl. Mech. Eng. 313, 986-1005, do so with all stresses).
        """
        if not self.mixed:
            return guess
        return replace(guess, volumes=self.system.linear_volumes(state, guess.u - state.u))

    def equilibrate(
        self,
        guess: State,
        load_step: LoadStep,
        *,
        forces: Forces | None = None,
        tolerance: float | None = None,
        patient: bool = True,
    ) -> tuple[State, Forces]:
        """The equilibrium near a guess; raises NotConverged.

        forces : at the guess, where nothing else was evaluated since
        tolerance : other than the settings', for an increment on the way
        patient : False gives up early, where a shorter step is the better answer
        """
        system, settings = self.system, self.settings
        target = settings.tolerance if tolerance is None else tolerance
        system.at(guess.time)
        state = guess
        forces = forces if forces is not None else self.forces(guess)
        if forces.worst <= 0:
            raise self.failure(state, forces, load_step, 0, "a cell was inverted by the first guess")
        sizes: list[float] = []
        self.nearest = np.inf, None
        renew, stagnation = True, Stagnation(settings.stalled)
        for iteration in range(settings.max_iterations + 1):
            self.report(load_step, iteration, forces)
            self.note(stagnation, state, forces)
            left = norm(forces.mixed) / max(forces.scale, 1e-14)
            if forces.worst > 0 and left < self.nearest[0]:
                self.nearest = left, replace(state, hints=system.hints())
            if self.is_reached(forces, target):
                return self.accepted(state, forces, load_step, iteration)
            if iteration == settings.max_iterations or stagnation.goes_round:
                break
            sizes.append(norm(forces.mixed) / max(forces.scale, 1e-14))
            if not patient and _too_long(sizes):
                if stagnation.will_do:
                    break
                raise self.failure(state, forces, load_step, iteration, "the step is too long")
            self.counts.iterations += 1
            step = self.direction(state, forces, renew, target)
            before = forces.error
            state, forces, length = self.search(state, forces, step, iteration)
            if length == 0.0 and renew:
                break
            renew = forces.error > settings.renew_ratio * before
        if stagnation.will_do:
            return self.accepted(*self.least_of(stagnation), load_step, iteration)
        raise self.failure(state, forces, load_step, iteration, "Newton's method made no further progress")

    def is_reached(self, forces: Forces, target: float) -> bool:
        """Whether this is equilibrium, to a tolerance or to round-off."""
        return forces.error <= target or norm(forces.residual) <= _ROUND_OFF * self.system.least_force

    def accepted(
        self, state: State, forces: Forces, load_step: LoadStep, iteration: int
    ) -> tuple[State, Forces]:
        """An equilibrium as it is kept; raises NotConverged where a cell of it is inside out."""
        worst, place = self.system.smallest_mean_volume(state)
        if worst <= 0:
            self.nearest = np.inf, None
            turned = replace(forces, worst=worst, place=place)
            raise self.failure(state, turned, load_step, iteration, "a cell was inverted")
        return replace(state, hints=self.system.hints(), volumes=()), forces

    def note(self, stagnation: Stagnation, state: State, forces: Forces) -> None:
        stagnation.note(replace(state, hints=self.system.hints(), volumes=()), forces)

    def least_of(self, stagnation: Stagnation) -> tuple[State, Forces]:
        """The state that left least, with its contact found anew."""
        assert stagnation.state is not None
        self.system.recall(stagnation.state.hints)
        forces = self.forces(stagnation.state)
        return replace(stagnation.state, hints=self.system.hints()), forces

    def direction(self, state: State, forces: Forces, renew: bool, target: float) -> Array:
        """Newton step: elastic tangent renewed where asked, factor renewed where GMRES has become slow."""
        linearised = self.linearised
        if linearised.is_outdated:
            linearised.refresh(state, forces.nodal)
        elif renew or linearised.tangent is None:
            linearised.assemble(state, forces.nodal)
        size = min(norm(forces.mixed), norm(forces.residual))
        error = size / max(forces.scale, 1e-14)
        goal = size * float(np.clip(_SHARE * max(error, target / max(error, 1e-14)), *_FORCING))
        tissue = forces.residual - self.system.contact_residual(state)
        far = error > _FAR
        step = linearised.settle(state, tissue, goal, far=far)
        if linearised.stuck:  # the factor is too old to be of use
            self.forces(state)
            linearised.refresh(state, forces.nodal)
            step = linearised.settle(state, tissue, goal, far=far)
        return step

    def search(
        self, state: State, forces: Forces, step: Array, iteration: int
    ) -> tuple[State, Forces, float]:
        """Shorten the step until no cell is inverted and the residual does not run away.

        Far from equilibrium the residual of a good step may be several times the one before; only
        later must it fall, at the step's own pressures or at those of its displacements.
        """
        before, before_all = norm(forces.mixed), norm(forces.residual)
        full = self.system.moved(state, step)
        mixed = self.mixed
        if mixed:
            nows = state.volumes or self.system.linear_volumes(state, np.zeros_like(state.u))
            aims = self.system.linear_volumes(state, full.u - state.u)
        allowed = _PATIENCE if iteration < _PATIENT_ITERATIONS else 1.0
        length = 1.0
        best: tuple[float, State, Forces, float] | None = None
        for _ in range(7):
            trial = self.system.moved(state, length * step)
            if mixed:
                trial = replace(trial, volumes=_between(nows, aims, length))
            result = self.forces(trial)
            size, size_all = norm(result.mixed), norm(result.residual)
            if result.worst > 0 and np.isfinite(size):
                enough = allowed * (1.0 - 0.1 * length)
                if size <= enough * before or size_all <= (1.0 - 0.1 * length) * before_all:
                    return trial, result, length
                if best is None or size < best[0]:
                    best = (size, trial, result, length)
            length *= 0.5
        if best is None or best[0] > 2.0 * before:
            self.forces(state)
            return state, forces, 0.0
        self.forces(best[1])
        return best[1], best[2], best[3]

    def report(self, load_step: LoadStep, iteration: int, forces: Forces) -> None:
        self.progress.event(
            "newton",
            step=load_step.number,
            n_steps=load_step.n_steps,
            iteration=iteration,
            residual=forces.error,
            target=self.settings.tolerance,
            depth=load_step.depth,
            krylov=self.counts.krylov,
            factorisations=self.counts.factorisations,
        )

    def failure(
        self, state: State, forces: Forces, load_step: LoadStep, iteration: int, why: str
    ) -> NotConverged:
        """The error of a load step that was not reached, with the worst place."""
        system = self.system
        if forces.worst <= 0:
            k, cell = forces.place
            nodes = system.groups[k].cells[cell]
            place, what = (system.X + state.u)[nodes].mean(axis=0), "inverted cell"
        else:
            size = np.where(system.free, forces.nodal, 0.0)
            node = int(np.argmax((size**2).sum(axis=1)))
            place, what = (system.X + state.u)[node], f"largest at node {node}"
        return NotConverged(
            f"{load_step.at(state.time, self.depth(state))}"
            f" stopped at residual {forces.error:.1e} after {iteration} iterations,"
            f" target {self.settings.tolerance:.0e}: {why}",
            where=f"{what}, at {_mm(place)}",
            fix="use more load steps; check the mesh quality there; lower the contact penalty",
            level=load_step.number,
            residual=forces.error,
            depth=load_step.depth,
        )

    def depth(self, state: State) -> float:
        """How far the body of the first contact, else the first, has gone in, mm; 0 without bodies."""
        system = self.system
        b = system.pairs[0].body if system.pairs else 0
        return -float(system.center(b, state)[2]) if system.bodies else 0.0

    def depth_at(self, time: float) -> float:
        """The same, where it is given, at a time."""
        return self.depth(self.system.prescribed(self.system.start, time))

    def weakness(self, state: State) -> str:
        """What is about to happen to tissue that could not be followed beyond a state, and where."""
        system = self.system
        system.at(state.time)
        forces = self.forces(state)
        if forces.worst < _NEARLY_FLAT:
            k, cell = forces.place
            middle = (system.X + state.u)[system.groups[k].cells[cell]].mean(axis=0)
            return f"an element at {_mm(middle)} is about to invert: volume ratio {forces.worst:.2f}"
        try:
            self.linearised.refresh(state, forces.nodal)
        except SolveError:
            return "the tissue cannot carry load there"
        n_soft = self.linearised.n_unstable
        if n_soft:
            return f"the tissue is losing its stability: the skin folds ({n_soft} unstable modes)"
        return "contact changes from iteration to iteration"

    def close(self) -> None:
        self.linearised.close()
        self.system.close()


def _mm(place: Array) -> str:
    return f"({place[0]:.1f}, {place[1]:.1f}, {place[2]:.1f}) mm"


def _between(nows: tuple[Array, ...], aims: tuple[Array, ...], part: float) -> tuple[Array, ...]:
    return tuple(now + part * (aim - now) for now, aim in zip(nows, aims, strict=True))


def _too_long(sizes: list[float]) -> bool:
    """Whether a step whose residuals these are is better given up and halved."""
    now, first = sizes[-1], sizes[0]
    running_away = len(sizes) > 3 and now > max(0.5 * first, 0.15)
    stagnation = len(sizes) > 6 and now > 0.5 * sizes[-6]
    return running_away or stagnation or (len(sizes) > 10 and now > 1e-2)
