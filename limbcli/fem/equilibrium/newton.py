"""Equilibrium at one time: Newton's method that reuses matrix factors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.contacts.contact_state import ContactState
from limbcli.fem.equilibrium.linearised import Linearised
from limbcli.fem.equilibrium.settings import Counts, LoadStep, Settings, WorkMeter
from limbcli.fem.equilibrium.stagnation import Stagnation
from limbcli.fem.motion.state import Forces, State, norm
from limbcli.fem.system import System
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

_PATIENCE, _PATIENT_ITERATIONS = 10.0, 4  # growth of the residual allowed per step, in the first iterations
_ROUND_OFF = 1e-6  # residual regarded as round-off, as a fraction of `System.least_force`
_FORCING = (1e-4, 0.1)  # bounds on the forcing term, the relative tolerance of the linear solve
_LINEAR = 1e-8  # relative tolerance of the linear solve of a first iterate
_ROUGH = 0.1  # relative tolerance of the linear solve of the tangent predictor
_FAR = 0.1  # relative residual above which contact tractions are regarded as far from those at equilibrium
_RENEWED = 1e-3  # the elastic tangent is reassembled after an iteration that leaves more of the residual
_NEARLY_FLAT = 0.4  # volume ratio below which an element is reported as about to invert
_SHARE = 0.6  # forcing term as a fraction of the residual reduction expected of quadratic convergence


class NotConverged(SolveError):
    """Newton's method did not converge at one time; the caller may cut the step."""


class Newton:
    """Newton solver of one system; keeps its tangent and factor between times.

    volume_ratios : whether independent volume ratios are in use (see `with_volumes`)
    nearest : smallest relative residual (`Forces.iterated`) of the last attempt, and its state
    """

    def __init__(self, system: System, settings: Settings, progress: Progress = SILENT):
        self.system, self.settings, self.progress = system, settings, progress
        self.counts = Counts()
        self.linearised = Linearised(system, settings, self.counts)
        self.volume_ratios = settings.volume_ratios
        self.nearest: tuple[float, State | None] = (np.inf, None)

    @property
    def linear_name(self) -> str:
        linear = self.linearised.linear
        return str(linear.name) if linear is not None else "none"

    def forces(self, state: State, *, contact: ContactState | None = None) -> Forces:
        """Forces at a state; contact : found there, if it has been searched already."""
        self.counts.residuals += 1
        return self.system.forces(state, contact=contact)

    def predict(self, state: State, time: float) -> State:
        """Tangent predictor: the state extrapolated linearly to `time`.

        Boundary motions are distributed over the tissue, so that no single element takes the whole step.
        """
        system, linearised = self.system, self.linearised
        system.at(time)
        forces = self.forces(replace(state, time=time, volumes=()))
        if linearised.is_outdated:
            linearised.refresh(state, forces)
        else:
            linearised.assemble(state, forces)
        aim = system.prescribed(state, time)
        v = np.where(system.free, 0.0, aim.u - state.u)
        motions = np.zeros((len(system.bodies), 6))
        for b in range(len(system.bodies)):
            motions[b, :3] = aim.bodies[b].shift - state.bodies[b].shift
        change = system.tangent_times(state, v) if v[system.coupled].any() else np.zeros_like(v)
        contact = system.contact_residual(forces.contact)
        tissue = forces.residual - contact
        tissue[: system.n_tissue] += change[system.free]
        rhs = tissue + contact + system.contact_change(forces.contact, motions=motions)
        first = linearised.solve(forces.contact, -rhs, _ROUGH)
        goal = _ROUGH * norm(rhs)
        step, found = linearised.settle(aim, tissue, goal, forces.contact, first=first, far=True)
        guess = system.moved(replace(aim, hints=found.state.hints), step)
        return self.with_volumes(guess, state)

    def first_iterate(self, state: State, time: float) -> State:
        """Where one linear solve from `state` leads at another time: in general no equilibrium."""
        system = self.system
        system.at(time)
        guess = system.prescribed(state, time)
        forces = self.forces(guess)
        self.linearised.refresh(guess, forces)
        return system.moved(guess, self.linearised.solve(forces.contact, -forces.residual, _LINEAR))

    def with_volumes(self, guess: State, state: State) -> State:
        """The guess with volume ratios, and hence pressures, linear in its step from `state`.

        A displacement step changes volumes in second order too; multiplied by the bulk stiffness this is a
        pressure far beyond the actual ones, and the tangent there is useless. The tangent is therefore
        evaluated at independent volume ratios, which agree with the displacements at convergence: Newton's
        method in displacements and pressures, with the pressures eliminated (Magisano, Leonetti and Garcea
        2017, Comput. Methods Appl. Mech. Eng. 313, 986-1005, do so with all stresses).
        """
        if not self.volume_ratios:
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
        """Solve for equilibrium from an initial guess; raises NotConverged.

        forces : forces at the guess, if they are known
        tolerance : relative residual, in place of the settings', for an intermediate increment
        patient : False gives up early if a shorter step is more promising
        """
        system, settings = self.system, self.settings
        target = settings.tolerance if tolerance is None else tolerance
        system.at(guess.time)
        state = guess
        forces = forces if forces is not None else self.forces(guess)
        if forces.worst <= 0:
            raise self.failure(forces, load_step, 0, "a cell was inverted by the first guess")
        sizes: list[float] = []
        self.nearest = np.inf, None
        renew, stagnation = True, Stagnation(settings.stalled)
        for iteration in range(settings.max_iterations + 1):
            self.report(load_step, iteration, forces)
            stagnation.note(forces)
            state = replace(state, hints=forces.contact.state.hints)
            left = norm(forces.iterated) / max(forces.scale, 1e-14)
            if forces.worst > 0 and left < self.nearest[0]:
                self.nearest = left, state
            if self.is_reached(forces, target):
                return self.accepted(forces, load_step, iteration)
            if iteration == settings.max_iterations or stagnation.repeats:
                break
            sizes.append(norm(forces.iterated) / max(forces.scale, 1e-14))
            if not patient and _too_long(sizes):
                if stagnation.acceptable:
                    break
                raise self.failure(forces, load_step, iteration, "the step is too long")
            self.counts.iterations += 1
            step, found = self.direction(state, forces, renew, target, begins=iteration == 0)
            before = forces.error
            state = replace(state, hints=found.state.hints)
            state, forces, length = self.search(state, forces, step, iteration, contact=found)
            if length == 0.0 and renew:
                break
            renew = forces.error > _RENEWED * before
        if stagnation.acceptable:
            return self.accepted(stagnation.acceptable, load_step, iteration)
        raise self.failure(forces, load_step, iteration, "Newton's method made no further progress")

    def is_reached(self, forces: Forces, target: float) -> bool:
        """Whether the residual is within the tolerance or at round-off level."""
        return forces.error <= target or norm(forces.residual) <= _ROUND_OFF * self.system.least_force

    def accepted(self, forces: Forces, load_step: LoadStep, iteration: int) -> tuple[State, Forces]:
        """The converged state with these forces; raises NotConverged if a cell's mean F is inverted."""
        state = forces.contact.state
        worst, cell = self.system.smallest_mean_volume(state)
        if worst <= 0:
            self.nearest = np.inf, None
            turned = replace(forces, worst=worst, worst_cell=cell)
            raise self.failure(turned, load_step, iteration, "a cell was inverted")
        return state, forces

    def direction(
        self, state: State, forces: Forces, renew: bool, target: float, *, begins: bool = False
    ) -> tuple[Array, ContactState]:
        """Newton step, and the contact found last: reassembles the tangent if `renew`, refactors if GMRES has
        become slow.

        begins : this is the first step of an increment
        """
        linearised = self.linearised
        if linearised.is_outdated or (begins and linearised.spared):
            linearised.refresh(state, forces)
        elif renew or linearised.tangent is None:
            linearised.assemble(state, forces)
        size = min(norm(forces.iterated), norm(forces.residual))
        error = size / max(forces.scale, 1e-14)
        goal = size * float(np.clip(_SHARE * max(error, target / max(error, 1e-14)), *_FORCING))
        tissue = forces.residual - self.system.contact_residual(forces.contact)
        far = error > _FAR
        found = linearised.settle(state, tissue, goal, forces.contact, far=far)
        too_old = linearised.stuck and not linearised.is_fresh(state)
        if begins:
            linearised.note_begun(too_old=too_old)
        if too_old:
            linearised.refactor(state, forces)
            found = linearised.settle(state, tissue, goal, forces.contact, far=far)
        return found

    def search(
        self, state: State, forces: Forces, step: Array, iteration: int, *,
        contact: ContactState | None = None,
    ) -> tuple[State, Forces, float]:  # fmt: skip
        """Line search: shorten the step until no cell is inverted and the residual does not diverge.

        In the first iterations the residual of a good step may be several times the previous one; later it
        must decrease, with either the independent volume ratios or those of the displacements.

        contact : the last one of the linearised tissue, mostly that after the whole step
        """
        before, before_all = norm(forces.iterated), norm(forces.residual)
        full = self.system.moved(state, step)
        if self.volume_ratios:
            ratios = state.volumes or self.system.linear_volumes(state, np.zeros_like(state.u))
            ratios_full = self.system.linear_volumes(state, full.u - state.u)
        allowed = _PATIENCE if iteration < _PATIENT_ITERATIONS else 1.0
        length = 1.0
        best: tuple[float, State, Forces, float] | None = None
        for _ in range(7):
            trial = self.system.moved(state, length * step)
            if self.volume_ratios:
                trial = replace(trial, volumes=_between(ratios, ratios_full, length))
            if contact is None or not np.array_equal(contact.state.u, trial.u):
                contact = self.system.search(trial, before=contact)
            result = self.forces(trial, contact=contact)
            size, size_all = norm(result.iterated), norm(result.residual)
            if result.worst > 0 and np.isfinite(size):
                enough = allowed * (1.0 - 0.1 * length)
                if size <= enough * before or size_all <= (1.0 - 0.1 * length) * before_all:
                    return trial, result, length
                if best is None or size < best[0]:
                    best = (size, trial, result, length)
            length *= 0.5
        if best is None or best[0] > 2.0 * before:
            return state, forces, 0.0
        return best[1], best[2], best[3]

    def report(self, load_step: LoadStep, iteration: int, forces: Forces) -> None:
        """Report the state of an iteration, and charge the work since the last one."""
        self.progress.event(
            "newton",
            step=load_step.number,
            n_steps=load_step.n_steps,
            iteration=iteration,
            residual=forces.error,
            target=self.settings.tolerance,
            depth=load_step.depth,
            aim=load_step.aim,
            time=load_step.time,
            krylov=self.counts.krylov,
            factorisations=self.counts.factorisations,
        )
        if load_step.meter is not None:
            load_step.meter.charge(load_step)

    def failure(self, forces: Forces, load_step: LoadStep, iteration: int, why: str) -> NotConverged:
        """The error for a load step that was not reached, with the location of the worst cell or node."""
        system, state = self.system, forces.contact.state
        if forces.worst <= 0:
            k, cell = forces.worst_cell
            group = system.groups[k]
            point = (system.X + state.u)[group.cells[cell]].mean(axis=0)
            what = f"inverted element {system.model.mesh.cell_id(group.first + cell)}"
        else:
            size = np.where(system.free, forces.nodal, 0.0)
            node = int(np.argmax((size**2).sum(axis=1)))
            point, what = (system.X + state.u)[node], f"largest at node {system.model.mesh.node_id(node)}"
        return NotConverged(
            f"{load_step.at(state.time, self.reached(state))}"
            f" stopped at residual {forces.error:.1e} after {iteration} iterations,"
            f" target {self.settings.tolerance:.0e}: {why}",
            where=f"{what}, at {_mm(point)}",
            fix="use more load steps; check the mesh quality there; lower the contact penalty",
            level=load_step.number,
            residual=forces.error,
            depth=load_step.depth,
        )

    def depth(self, state: State) -> float | None:
        """Indentation depth (mm) of the first contact's body, or else of the first body; None unless that is
        moved along z."""
        system = self.system
        b = system.first_touched
        drive = system.bodies[b].drives.get("z") if system.bodies else None
        if drive is None or drive.kind != "displacement":
            return None
        return -float(system.center(b, state)[2])

    def reached(self, state: State) -> str:
        """Depth, or else the force applied, of the first contact's (or the first) body in words; "" where it
        has neither."""
        depth = self.depth(state)
        if depth is not None:
            return f"depth {depth:.2f} mm"
        if not self.system.bodies:
            return ""
        b = self.system.first_touched
        size = float(np.linalg.norm(self.system.applied(state.time)[b, :3]))
        return f"force {size:.4g} N" if size else ""

    def load_step(self, number: int, n_steps: int, time: float, meter: WorkMeter | None = None) -> LoadStep:
        """The load step that ends at a time."""
        aim = self.system.prescribed(self.system.start, time)
        return LoadStep(number, n_steps, self.depth(aim), self.reached(aim), time, meter)

    def weakness(self, state: State) -> str:
        """The likely reason, with its location, why no equilibrium was found beyond a state."""
        system = self.system
        system.at(state.time)
        forces = self.forces(state)
        if forces.worst < _NEARLY_FLAT:
            k, cell = forces.worst_cell
            group = system.groups[k]
            middle = (system.X + state.u)[group.cells[cell]].mean(axis=0)
            name = f"element {system.model.mesh.cell_id(group.first + cell)}"
            return f"{name} at {_mm(middle)} is about to invert: volume ratio {forces.worst:.2f}"
        try:
            self.linearised.refresh(state, forces)
        except SolveError:
            return "the tissue cannot carry load there"
        n_soft = self.linearised.n_unstable
        if n_soft:
            return f"the tissue is losing its stability: the skin folds ({n_soft} unstable modes)"
        return "contact changes from iteration to iteration"

    def close(self) -> None:
        self.linearised.close()
        self.system.close()


def _mm(point: Array) -> str:
    return f"({point[0]:.1f}, {point[1]:.1f}, {point[2]:.1f}) mm"


def _between(begin: tuple[Array, ...], end: tuple[Array, ...], part: float) -> tuple[Array, ...]:
    return tuple(a + part * (b - a) for a, b in zip(begin, end, strict=True))


def _too_long(sizes: list[float]) -> bool:
    """Whether a step with these residuals should be abandoned and halved."""
    now, first = sizes[-1], sizes[0]
    running_away = len(sizes) > 3 and now > max(0.5 * first, 0.15)
    stagnation = len(sizes) > 6 and now > 0.5 * sizes[-6]
    return running_away or stagnation or (len(sizes) > 10 and now > 1e-2)
