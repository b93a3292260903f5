"""Equilibrium at one time: Newton's method with few factorisations."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem import linear as linear_solvers
from limbcli.fem.state import Forces, State, norm
from limbcli.fem.system import System
from limbcli.fem.tangent import Inverse, Tangent, assemble, gmres
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

_PATIENCE, _PATIENT_ITERATIONS = 10.0, 4
_MAX_KRYLOV = 40
_ROUND_OFF = 1e-6  # of the least force: what no iteration takes away
_LARGE = 6_000  # equations, from which on single precision pays
_TIGHTEST = (1e-4, 1e-2)  # to which the linear system of a step is solved: near equilibrium, far from it
_FRESH = 3.0  # Krylov iterations a decade takes with a fresh factor


class NotConverged(SolveError):
    """Newton's method gave up at one time; the caller may cut the step."""


@dataclass(frozen=True)
class Settings:
    """How equilibrium is sought.

    tolerance : residual over the forces at play, both as norms
    renew_ratio : the elastic tangent is renewed after an iteration that gains less than this
    single : factor in single precision (None: for large systems); GMRES makes up for it
    linear : "auto", "pardiso" or "superlu"
    mixed : pressures and tractions of their own on the way to equilibrium (see `Newton.with_volumes`)
    """

    tolerance: float = 1e-6
    max_iterations: int = 30
    linear: str = "auto"
    threads: int = 2
    single: bool | None = None
    mixed: bool = True
    renew_ratio: float = 0.1


@dataclass
class Counts:
    """What the work cost."""

    iterations: int = 0
    residuals: int = 0
    krylov: int = 0
    factorisations: int = 0
    retries: int = 0
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Level:
    """Where the load stands, for messages."""

    number: int
    n_levels: int
    depth: float


class Newton:
    """Keeps the factor and the tangent of one system between times."""

    def __init__(self, system: System, settings: Settings, progress: Progress = SILENT):
        self.system, self.settings, self.progress = system, settings, progress
        self.counts = Counts()
        self.tangent: Tangent | None = None
        self.inverse: Inverse | None = None
        self.debt = 0.0
        self.rate = _FRESH
        self.stuck = False
        single = settings.single if settings.single is not None else system.n_tissue > _LARGE
        pattern = system.pattern
        self.linear: Any = (
            linear_solvers.make(
                pattern.indptr,
                pattern.indices,
                kind=settings.linear,
                threads=settings.threads,
                single=single,
            )
            if system.n_tissue
            else None
        )

    @property
    def linear_name(self) -> str:
        return self.linear.name if self.linear is not None else "none"

    def forces(self, state: State) -> Forces:
        self.counts.residuals += 1
        return self.system.forces(state)

    def refresh(self, state: State, forces: Forces) -> None:
        """Assemble and factor the tangent at a state."""
        self.tangent = assemble(self.system, state, forces.nodal)
        self.inverse = Inverse(self.tangent, state, self.linear)
        if state.time == 0.0 and self.linear is not None:
            linear_solvers.check_supported(self.linear)
        self.counts.factorisations += 1
        self.debt = 0.0

    def solve_linear(self, state: State, rhs: Array, tolerance: float) -> Array:
        """Solve with the exact contact tangent and the last elastic tangent.

        `debt` counts the Krylov iterations that a fresh factor would have saved, in factorisations:
        at 1 it has cost as much as a new one.
        """
        assert self.tangent is not None
        assert self.inverse is not None
        tangent, inverse = self.tangent, self.inverse
        step, n, reached = gmres(
            lambda v: tangent.times(state, v), inverse, rhs, tolerance=tolerance, max_iterations=self.patience
        )
        self.counts.krylov += n
        self.stuck = reached > max(3 * tolerance, 1e-9)
        decades = max(-np.log10(max(reached, 1e-16)), 0.3)
        self.rate = n / decades
        self.debt += max(n - _FRESH * decades, 0.0) / self.per_factor
        return step

    @property
    def per_factor(self) -> float:
        """What a factorisation costs, in solves."""
        return float(self.linear.solves_per_factor) if self.linear is not None else 1.0

    @property
    def patience(self) -> int:
        """Krylov iterations after which a stale factor has cost more than a new one."""
        return int(np.clip(self.per_factor, 12, _MAX_KRYLOV))

    def ready_for(self, n_solves: int, decades: float, state: State, forces: Forces) -> None:
        """The exact tangent at a state, with a new factor if that pays for so many solves to come."""
        wasted = n_solves * decades * (self.rate - _FRESH)
        if self.inverse is None or wasted > self.per_factor:
            self.refresh(state, forces)
            self.rate = _FRESH
        elif self.tangent is None or self.tangent.state is not state:
            self.tangent = assemble(self.system, state, forces.nodal)

    def predict(self, state: State, time: float) -> State:
        """The state moved to `time` along the tangent: no element sees the whole step at once."""
        system = self.system
        system.at(time)
        forces = self.forces(replace(state, time=time, volumes=(), tractions=()))
        if self.inverse is None or self.debt > 1.0:
            self.refresh(state, forces)
        else:
            self.tangent = assemble(system, state, forces.nodal)
        aim = system.prescribed(state, time)
        v = np.where(system.free, 0.0, aim.u - state.u)
        motions = np.zeros((len(system.bodies), 6))
        for b in range(len(system.bodies)):
            motions[b, :3] = aim.bodies[b].shift - state.bodies[b].shift
        change = system.tangent_times(state, v) if v[system.coupled].any() else np.zeros_like(v)
        if system.pairs:
            nodal, bodies = system.contact_times(state, v, motions)
            change += nodal
        rhs = forces.residual.copy()
        rhs[: system.n_tissue] += change[system.free]
        if len(system.rigid) and system.pairs:
            for k, (b, dof) in enumerate(system.rigid):
                rhs[system.n_tissue + k] += bodies[b, dof]
        guess = system.moved(aim, self.solve_linear(state, -rhs, 1e-2))
        return self.with_volumes(guess, state)

    def with_volumes(self, guess: State, state: State) -> State:
        """The guess with pressures that follow its step from `state` linearly.

        A step of the displacements changes the volumes in second order too; times the bulk stiffness
        that is a pressure far beyond those at play, and its tangent leads nowhere. So the tangent is
        taken at pressures of their own, which catch up as the iteration converges: Newton's method on
        displacements and pressures, the latter eliminated (Magisano, Leonetti and Garcea 2017, Comput.
        Methods Appl. Mech. Eng. 313, 986-1005, do so with all stresses).
        """
        if not self.settings.mixed:
            return guess
        volumes, tractions = self.linear_stresses(state, guess)
        return replace(guess, volumes=volumes, tractions=tractions)

    def linear_stresses(self, state: State, after: State) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Volume ratios and contact tractions, changed linearly from a state (searched last) to another."""
        v = after.u - state.u
        motions = np.zeros((len(self.system.bodies), 6))
        for b in range(len(motions)):
            motions[b, :3] = after.bodies[b].shift - state.bodies[b].shift
        return self.system.linear_volumes(state, v), self.system.linear_tractions(state, v, motions)

    def equilibrate(
        self,
        guess: State,
        level: Level,
        *,
        forces: Forces | None = None,
        tolerance: float | None = None,
        patient: bool = True,
    ) -> tuple[State, Forces]:
        """The equilibrium near a guess; raises NotConverged.

        forces : at the guess, where nothing else was evaluated since
        tolerance : other than the settings', for a level on the way
        patient : False gives up early, where a shorter step is the better answer
        """
        system, settings = self.system, self.settings
        target = settings.tolerance if tolerance is None else tolerance
        system.at(guess.time)
        state = guess
        forces = forces if forces is not None else self.forces(guess)
        if forces.worst <= 0:
            raise self.failure(state, forces, level, 0, "a cell was turned inside out by the first guess")
        sizes: list[float] = []
        renew = True
        for iteration in range(settings.max_iterations + 1):
            self.report(level, iteration, forces)
            if forces.error <= target or norm(forces.residual) <= _ROUND_OFF * system.least_force:
                return replace(state, hints=system.hints(), volumes=(), tractions=system.tractions()), forces
            if iteration == settings.max_iterations:
                break
            sizes.append(norm(forces.mixed) / max(forces.scale, 1e-14))
            if not patient and _too_long(sizes):
                raise self.failure(state, forces, level, iteration, "the step is too long")
            self.counts.iterations += 1
            step = self.direction(state, forces, renew, target)
            before = forces.error
            state, forces, length = self.search(state, forces, step, iteration)
            if length == 0.0 and renew:
                break
            renew = forces.error > settings.renew_ratio * before
        raise self.failure(state, forces, level, iteration, "Newton's method made no further progress")

    def direction(self, state: State, forces: Forces, renew: bool, target: float) -> Array:
        """Newton step: elastic tangent renewed where asked, factor renewed where GMRES has become slow.

        While the set of touching points changes, a step gains a decade or so, however well it is
        solved for.
        """
        if self.inverse is None or self.debt > 1.0:
            self.refresh(state, forces)
        elif renew or self.tangent is None:
            self.tangent = assemble(self.system, state, forces.nodal)
        least = float(np.clip(forces.error, *_TIGHTEST))
        most = max(least, min(0.1, forces.error**0.5))
        forcing = float(np.clip(0.3 * target / forces.error, least, most))
        step = self.solve_linear(state, -forces.residual, forcing)
        if self.stuck:  # the factor is too old to be of use
            self.refresh(state, forces)
            step = self.solve_linear(state, -forces.residual, forcing)
        return step

    def search(
        self, state: State, forces: Forces, step: Array, iteration: int
    ) -> tuple[State, Forces, float]:
        """Shorten the step until no cell is inverted and the residual does not run away.

        While the set of touching points still changes, the residual of a good step may be
        several times the one before; only later must it fall, at the step's own pressures or at those
        of its displacements.
        """
        before, before_all = norm(forces.mixed), norm(forces.residual)
        full = self.system.moved(state, step)
        mixed = self.settings.mixed
        if mixed:
            nows = (
                state.volumes or self.system.linear_volumes(state, np.zeros_like(state.u)),
                state.tractions or self.system.tractions(),
            )
            aims = self.linear_stresses(state, full)
        allowed = _PATIENCE if iteration < _PATIENT_ITERATIONS else 1.0
        length = 1.0
        best: tuple[float, State, Forces, float] | None = None
        for _ in range(7):
            trial = self.system.moved(state, length * step)
            if mixed:
                volumes, tractions = (_between(*both, length) for both in zip(nows, aims, strict=True))
                trial = replace(trial, volumes=volumes, tractions=tractions)
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

    def report(self, level: Level, iteration: int, forces: Forces) -> None:
        self.progress.event(
            "newton",
            step=level.number,
            n_steps=level.n_levels,
            iteration=iteration,
            residual=forces.error,
            target=self.settings.tolerance,
            depth=level.depth,
        )

    def failure(self, state: State, forces: Forces, level: Level, iteration: int, why: str) -> NotConverged:
        """The error of a level that was not reached, with the worst place."""
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
            f"load level {level.number} of {level.n_levels}"
            f" (time {state.time:.6g}, depth {level.depth:.2f} mm)"
            f" stopped at residual {forces.error:.1e} after {iteration} iterations,"
            f" target {self.settings.tolerance:.0e}: {why}",
            where=f"{what}, at ({place[0]:.1f}, {place[1]:.1f}, {place[2]:.1f}) mm",
            fix="use more load steps; look at the mesh quality there; lower the contact penalty",
            level=level.number,
            residual=forces.error,
            depth=level.depth,
        )

    def close(self) -> None:
        if self.linear is not None:
            self.linear.close()
        self.system.close()


def _between(nows: tuple[Array, ...], aims: tuple[Array, ...], part: float) -> tuple[Array, ...]:
    return tuple(now + part * (aim - now) for now, aim in zip(nows, aims, strict=True))


def _too_long(sizes: list[float]) -> bool:
    """Whether a step whose residuals these are is better given up and halved."""
    now, first = sizes[-1], sizes[0]
    running_away = len(sizes) > 3 and now > max(0.5 * first, 0.15)
    standing = len(sizes) > 6 and now > 0.5 * sizes[-6]
    return running_away or standing or (len(sizes) > 10 and now > 1e-2)
