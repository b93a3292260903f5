"""Load stepping with increments for which Newton's method converges: initial guesses and step cutting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.contacts.pairs import Pair
from limbcli.fem.equilibrium.first_guesses import beside, extrapolate
from limbcli.fem.equilibrium.history import Histories
from limbcli.fem.equilibrium.increments import Increment, IncrementOutcome, LoadStepPath, Reached
from limbcli.fem.equilibrium.newton import Newton, NotConverged
from limbcli.fem.equilibrium.relaxation import relax
from limbcli.fem.equilibrium.settings import LoadStep
from limbcli.fem.linear_solvers.singular import SingularMatrix
from limbcli.fem.motion.state import Forces, RoughState, State, norm
from limbcli.model import Array, LimbModel, Step

_MAX_CUTS = 8  # limit of successive cuts of an increment, unless the step allows more
BRIEF_CUTS, _BRIEF_ITERATIONS = 2, 40  # limits of cuts and of Newton iterations for a brief load step
_SMALLEST = 1e-3  # increments shorter than this fraction of the model's step size are not cut further
# Relative residual at which an intermediate increment is accepted, by default and once an increment of the
# load step has been cut: states solved to the loose tolerance then fail as starting points at any length.
_LOOSE, _FIRM = 3e-2, 1e-3
_RESTED = 1e-2  # the same for an intermediate increment solved by relaxation
_NEAR = 0.3  # relative residual up to which relaxation starts from Newton's best iterate
# After a guess from an earlier solve has failed, the part of the load step that is tried without it: where
# such a guess fails, the whole load step mostly does, too.
_WITHOUT_GUESS = 0.5
_FIRST = 4.0  # first increment as a multiple of the model's step size, for a path-independent response
_MOST_RELAXATIONS = 3  # number of failed relaxations per load step after which none is attempted
_FAR_OUT = 3.0  # relative residual of an initial guess above which an increment is shortened without a try
_FAR_FREE = 0.1  # the same above which the tangent predictor is taken where bodies move freely
_FAR_OFF = 0.5  # the same for a guess from an earlier solve
_FAR_OFF_ROUGH = 10.0  # the same for a guess from another mesh
_SHARES = (1.0, 0.5, 0.25, 0.125)  # of an augmentation, tried in turn until there is an equilibrium
_STEADY = 5  # number of increments after a cut during which they do not grow
_EASY = 4  # Newton iterations up to which an increment counts as easy, so that the next may be longer


class LoadStepping:
    """Advances through the load steps of one analysis step and adapts the increment length.

    histories : stress histories to advance with every increment
    """

    def __init__(
        self, model: LimbModel, step: Step, newton: Newton, histories: Histories | None = None
    ):  # fmt: skip
        self._step, self._newton, self._histories = step, newton, histories
        self._has_friction, self._timed = model.has_friction, model.is_viscoelastic
        # increments shorter than a load step only provide initial guesses
        self._incremental = bool(model.contacts) and not self._timed
        increment = _FIRST * step.step_size if self._incremental else np.inf
        self._reached = Reached((newton.system.start,), increment)

    def advance_to(
        self, target: float, load_step: LoadStep, known: State | None = None, *, brief: bool = False,
        patient: bool = True,
    ) -> tuple[State, Forces]:  # fmt: skip
        """Equilibrium at a time, reached by increments for which Newton's method converges.

        known : initial guess at the target, from an earlier solve
        brief : give up after a few cuts and iterations
        patient : fall back on relaxation where Newton's method fails

        Intermediate increments only provide initial guesses and are solved to a loose tolerance, except
        with a viscoelastic law. For their outcomes see `increments.IncrementOutcome`.
        """
        newton = self._newton
        newton.volume_ratios = newton.settings.volume_ratios
        way = LoadStepPath(
            target, load_step, known, brief, patient=patient, start=self._reached,
            most_cuts=BRIEF_CUTS if brief else max(_MAX_CUTS, self._step.max_retries),
            most_iterations=newton.counts.iterations + _BRIEF_ITERATIONS if brief else None,
        )  # fmt: skip
        while True:
            increment = self._next(way)
            outcome, found, error = self._attempt(way, increment)
            if found is not None:
                way.cuts = 0
                state, forces = self._take(way, increment, outcome, *found)
                if increment.is_last:
                    return state, forces
            elif outcome is IncrementOutcome.HOPELESS:
                assert error is not None
                raise self._explained(error, load_step, increment.aim) from error
            else:
                if outcome is IncrementOutcome.BEGIN_AGAIN:
                    # without independent volume ratios, which allow longer steps but occasionally diverge
                    self._reached = way.start
                    self._newton.volume_ratios = False
                    way.cuts = 0
                    increment = replace(
                        increment, begin=self._reached.last.time, aim=way.target, is_last=True
                    )
                self._shorten(way, increment)

    def _next(self, way: LoadStepPath) -> Increment:
        """The next increment to try; raises NotConverged if a brief load step exceeds its iterations."""
        newton, begin = self._newton, self._reached.last.time
        before = newton.counts.iterations
        if way.most_iterations is not None and before > way.most_iterations:
            spent = before - way.most_iterations + _BRIEF_ITERATIONS
            state = self._reached.last
            newton.system.at(state.time)
            raise newton.failure(newton.forces(state), way.load_step, spent, "it takes long")
        rest = way.target - begin
        n = 1 if way.known is not None else int(np.ceil(rest / self._reached.increment - 1e-6))
        while self._incremental and way.known is None and rest / n > self._step.step_size:
            if not newton.system.may_pass(self._reached.last, begin + rest / n):
                break
            n *= 2
        aim = way.target if n <= 1 else begin + rest / n
        return Increment(begin, aim, rest, before, is_last=aim == way.target)

    def _attempt(
        self, way: LoadStepPath, increment: Increment
    ) -> tuple[IncrementOutcome, tuple[State, Forces] | None, SolveError | None]:
        """The outcome of an increment, with the equilibrium found or the error."""
        patient = way.is_exhausted or self._newton.system.jumps
        try:
            found = self._solve(way, increment, patient=patient)
            if increment.is_last:
                found = self._augmented(*found, way)
        except (NotConverged, SingularMatrix) as error:
            exhausted = way.is_exhausted
            if way.known is None:
                way.note_cut()
            self._note_cut(error)
            at_rest = None if way.brief or not way.patient else self._at_rest(way, increment, error)
            if at_rest is not None:
                return IncrementOutcome.CAME_TO_REST, at_rest, None
            return self._outcome(way, increment, error, exhausted), None, error
        return IncrementOutcome.CONVERGED, found, None

    def _outcome(
        self, way: LoadStepPath, increment: Increment, error: SolveError, exhausted: bool
    ) -> IncrementOutcome:
        """How to continue after an increment without an equilibrium."""
        if _has_no_factor(error, self._reached.states):
            return IncrementOutcome.HOPELESS
        if not exhausted and increment.length >= _SMALLEST * self._step.step_size:
            return IncrementOutcome.SHORTEN
        path_dependent = self._timed or self._has_friction
        again = self._newton.volume_ratios and not path_dependent and not way.brief
        return IncrementOutcome.BEGIN_AGAIN if again else IncrementOutcome.HOPELESS

    def _take(
        self, way: LoadStepPath, increment: Increment, outcome: IncrementOutcome, state: State, forces: Forces
    ) -> tuple[State, Forces]:
        """Accept the final state of an increment and adapt the increment length."""
        easily = False
        if outcome is IncrementOutcome.CAME_TO_REST:
            way.known = None
            self._reached = replace(self._reached, increment=increment.length)
            if increment.is_last:
                state, forces = self._augmented(state, forces, way)
        else:
            easy = _EASY + (2 if increment.is_last else 0)
            easily = self._newton.counts.iterations - increment.iterations_before <= easy
        self._accept(state, forces, easily=easily)
        if increment.is_last and way.earlier is not None and forces.n_touching > 0:
            pairs = (*self._reached.pairs[-1:], (state, way.earlier))
            self._reached = replace(self._reached, pairs=pairs)
        return state, forces

    def _shorten(self, way: LoadStepPath, increment: Increment) -> None:
        """Halve the increment; after a guess from an earlier solve, go on without it from the last state."""
        newton = self._newton
        if way.known is not None:
            share = _WITHOUT_GUESS if self._incremental else 1.0
            self._reached = replace(self._reached, increment=share * increment.rest, n_steady=0)
        else:
            self._reached = replace(self._reached, increment=0.5 * increment.length, n_steady=_STEADY)
        way.known = None
        if newton.counts.iterations > increment.iterations_before:
            newton.linearised.reuse_cost = np.inf  # without an iteration the factor is still up to date

    def _at_rest(
        self, way: LoadStepPath, increment: Increment, error: SolveError
    ) -> tuple[State, Forces] | None:
        """The state found by pseudo-time relaxation; None if it fails or is not attempted.

        It starts from Newton's best iterate if that is close to equilibrium; otherwise, or after a failed
        relaxation, from the last increment's state. After a guess from an earlier solve, or at a first cut
        where no Newton iteration was made, a shorter increment is tried instead.
        """
        newton, begin = self._newton, self._reached.last
        # path-dependent response, or bodies with free degrees of freedom
        given = self._timed or self._has_friction or bool(newton.system.rigid)
        given |= way.failed_relaxations >= _MOST_RELAXATIONS
        if given or not isinstance(error, NotConverged) or self._reached.n_pressed < 2:
            return None
        left, guess = newton.nearest
        if way.known is not None or (guess is None and way.all_cuts == 1):
            return None
        if guess is None or left > _NEAR or way.failed_relaxations:
            guess = newton.system.prescribed(begin, increment.aim)
        newton.linearised.reuse_cost = np.inf
        try:
            return relax(newton, guess, way.load_step, tolerance=None if increment.is_last else _RESTED)
        except (NotConverged, SingularMatrix):
            way.failed_relaxations += 1
            return None

    def _note_cut(self, error: SolveError) -> None:
        self._newton.counts.retries += 1
        if isinstance(error, SingularMatrix):
            self._newton.linearised.inverse = None

    def _accept(self, state: State, forces: Forces, *, easily: bool) -> None:
        """Accept an increment: the next one starts at its end, and may be longer if this one was easy."""
        before = self._reached
        length = state.time - before.last.time
        n_steady = max(before.n_steady - 1, 0)
        longer = length >= 0.6 * before.increment and easily and not n_steady
        self._reached = replace(
            before, states=(*before.states, state), increment=before.increment * (2.0 if longer else 1.0),
            n_steady=n_steady, n_touching=forces.n_touching,
            n_pressed=before.n_pressed + int(forces.n_touching > 0),
        )  # fmt: skip
        if self._histories is not None:
            self._histories.accept(length, state)

    def _solve(self, way: LoadStepPath, increment: Increment, *, patient: bool) -> tuple[State, Forces]:
        newton, aim = self._newton, increment.aim
        on_the_way = _FIRM if way.all_cuts else _LOOSE
        tolerance = None if increment.is_last or self._timed else on_the_way
        newton.nearest = np.inf, None
        if self._histories is not None:
            self._histories.begin(increment.length)
        guess, forces = self._guess(aim, way.load_step, way.known, patient)
        if way.known is not None and not self._reached.pairs:  # the factor was computed a load step earlier
            newton.linearised.reuse_cost = np.inf
        return newton.equilibrate(guess, way.load_step, forces=forces, tolerance=tolerance, patient=patient)

    def _guess(
        self, time: float, load_step: LoadStep, known: State | None, patient: bool
    ) -> tuple[State, Forces]:
        """The best available initial guess, and the forces there.

        With an earlier solve: its state plus the difference from it, as far as known. Otherwise linear and
        quadratic extrapolation of the last states, or, if these are poor, the tangent predictor. If all
        guesses are far from equilibrium the increment is rejected at once, which is cheaper than iterating.
        """
        system, reached = self._newton.system, self._reached
        pairs: tuple[tuple[State, State], ...] = ()
        rough = isinstance(known, RoughState)
        if known is not None:
            if reached.pairs and reached.pairs[-1][0] is reached.last:
                pairs = reached.pairs[-1 if rough else -2 :]
            guesses = [beside(system, known, time, pairs[-n:]) for n in range(1, len(pairs) + 1)]
            guesses = guesses or [system.prescribed(known, time)]
        else:
            # neither the unloaded state nor states without contact are extrapolated
            most = min(reached.n_pressed if system.pairs else len(reached.states) - 1, 3)
            guesses = [extrapolate(system, reached.states[-n:], time) for n in range(2, most + 1)]
        limit = _FAR_OFF_ROUGH if rough else _FAR_OFF if known is not None and not pairs else _FAR_OUT
        error, guess, forces = self._best(guesses, time)
        if guess is None or (known is None and error > (_FAR_FREE if system.rigid else limit)):
            error, guess, forces = self._best([self._newton.predict(reached.last, time)], time)
        if guess is None or (error > limit and self._incremental and not patient and len(reached.states) > 1):
            assert forces is not None
            why = "the step is too long for a first guess"
            raise self._newton.failure(forces, load_step, 0, why)
        assert forces is not None
        return guess, forces

    def _best(self, guesses: list[State], time: float) -> tuple[float, State | None, Forces | None]:
        """The guess with the smallest error among those without inverted cells; its error and forces.

        None, with the forces at the last guess, if all of them have inverted cells.
        """
        self._newton.system.at(time)
        error, guess, forces = np.inf, None, None
        for each in guesses:
            found = self._newton.forces(each)
            own = found.error
            if len(guesses) > 1:  # penalise loss of contact, which lowers the residual misleadingly
                own += max(1.0 - found.n_touching / max(self._reached.n_touching, 1), 0.0)
            else:
                own = min(norm(found.iterated) / max(found.scale, 1e-14), own)
            if found.worst > 0 and own < error:
                error, guess, forces = own, each, found
        return error, guess, forces if guess is not None or not guesses else found

    def _explained(self, error: SolveError, load_step: LoadStep, time: float) -> SolveError:
        """The error, completed with its load step, the likely cause and the depth or force reached."""
        newton, n_reached, last = self._newton, len(self._reached.states) - 1, self._reached.last
        aim = newton.system.prescribed(newton.system.start, time)
        place = load_step.at(time, newton.reached(aim))
        what = error.what if isinstance(error, NotConverged) else f"{place}: {error.what}"
        depth = newton.depth(last)
        words = newton.reached(last)
        if words and depth is None:  # a force need not grow with time
            words = f"time {last.time:.4g}, {words}"
        reported = f"; there is a solution up to {words}" if n_reached and words else ""
        cause = "a part of the tissue, or a rigid body, can move freely"
        fix = error.fix
        if n_reached:
            cause = newton.weakness(last)
            less = "load" if depth is None else "depth"
            fix = f"reduce the {less}; check the mesh there; or use a lower contact penalty"
        return SolveError(
            what + reported,
            where=f"{error.where}; {cause}",
            fix=fix,
            level=load_step.number,
            depth=load_step.depth,
            reached_depth_mm=depth,
        )

    def _augmented(self, state: State, forces: Forces, way: LoadStepPath) -> tuple[State, Forces]:
        """Augmented Lagrangian iterations until the multipliers of every contact have converged."""
        every = enumerate(self._newton.system.pairs)
        pairs = [(k, pair) for k, pair in every if pair.contact.is_augmented]
        before = [pair.multipliers() for _, pair in pairs]
        n_before = 0
        try:
            earlier, settled = before, _augment(pairs, forces, n_before)
            while not all(settled):
                state, forces = self._after_augmentation(state, way.load_step, pairs, earlier)
                n_before += 1
                earlier = [pair.multipliers() for _, pair in pairs]
                settled = _augment(pairs, forces, n_before)
        except SolveError:
            for (_, pair), multipliers in zip(pairs, before, strict=True):
                pair.set_multipliers(multipliers)
            raise
        return state, forces

    def _after_augmentation(
        self, state: State, load_step: LoadStep, pairs: Sequence[tuple[int, Pair]],
        earlier: Sequence[list[tuple[Array, ...]]],
    ) -> tuple[State, Forces]:  # fmt: skip
        """Equilibrium with the multipliers as they are now, or as near to them as there is one within reach.

        state, earlier : the last equilibrium, and its multipliers. A shorter load increment would end in the
        same state and the same augmentation; any multipliers fulfil the law of contact, and the next
        augmentation goes on from these
        """
        full = [pair.multipliers() for _, pair in pairs]
        for share in _SHARES:
            for (_, pair), start, end in zip(pairs, earlier, full, strict=True):
                pair.set_multipliers(
                    [
                        tuple(a + share * (b - a) for a, b in zip(*patch, strict=True))
                        for patch in zip(start, end, strict=True)
                    ]
                )
            try:
                return self._newton.equilibrate(state, load_step, patient=share == _SHARES[-1])
            except NotConverged as error:
                self._note_cut(error)
                last = error
        raise last


def _augment(pairs: Sequence[tuple[int, Pair]], forces: Forces, n_before: int) -> list[bool]:
    return [pair.augment(forces.contact.points[k], n_before) for k, pair in pairs]


def _has_no_factor(error: SolveError, reached: Sequence[State]) -> bool:
    """Whether the unloaded tissue's matrix is singular: shorter steps would not help."""
    return isinstance(error, SingularMatrix) and len(reached) == 1 and reached[0].time == 0.0
