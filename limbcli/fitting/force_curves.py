"""Force at the depth levels as a function of (f_kappa, m), the forward model of `fit`.

With the reference solver, one session keeps the converged states and returns exact derivatives. Any
other solver is run on files, with finite differences whose runs share the available cores.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from limbcli.config import available_cores, shares
from limbcli.errors import SolveError
from limbcli.files.temporary_folders import scratch_folder
from limbcli.fitting.kept_solves import NOTHING_KEPT, CheckSolver, KeptForces, KeptSolves
from limbcli.fitting.laws import FitLaw
from limbcli.fitting.model_checks import ChangedBoundary
from limbcli.inference.parameter import F_KAPPA_BOUNDS, M_BOUNDS
from limbcli.inference.prediction import Differences, Prediction
from limbcli.model import Array, ElementMap, LimbModel
from limbcli.progress import SILENT, Progress
from limbcli.shear_waves.from_simulation import mean_speeds
from limbcli.site_model.indentation_model import TISSUE, softer_jumps, with_penalty, with_tissue
from limbcli.solvers.febio import FebioSolver
from limbcli.solvers.material_lines import FILE as LINES
from limbcli.solvers.material_lines import MaterialLines
from limbcli.solvers.session import ReferenceSession, SessionResult
from limbcli.solvers.session_options import StopWhen
from limbcli.solvers.solver import Simulation, Solver

if TYPE_CHECKING:
    from limbcli.solvers.session import Solved

_SAME_TIME = 1e-6
_C_STEP = 1.1  # factor on c in finite differences, for solvers without derivatives; their forces err by 1e-3


def _times(c: float | ElementMap, factor: float) -> float | ElementMap:
    return replace(c, values=factor * c.values) if isinstance(c, ElementMap) else factor * c


def at_levels(simulation: Simulation, values: Array, times: Array) -> Array:
    """Rows of `values` (n_times, ...) at the level times. Raises SolveError if a level was not reached."""
    nearest = np.abs(simulation.times[None, :] - times[:, None]).argmin(axis=1)
    missed = np.abs(simulation.times[nearest] - times) > _SAME_TIME
    if missed.any():
        k = int(np.flatnonzero(missed)[0])
        raise SolveError(
            f"level {k + 1} of {len(times)} (time {times[k]:g} s) is missing from the simulation",
            where=f"{simulation.solver}, {len(simulation.times)} converged steps",
            fix="run `limbcli run` and check model.log",
            level=k + 1,
        )
    return np.asarray(values[nearest])


class ReferenceCurve:
    """Forces at the levels and their exact derivatives, from one session of the reference solver.

    A solve updates `depths` (n_levels,) mm and `n_solves`, of which `n_kept` were `kept` by an earlier fit;
    `at_most`, if set, is told in progress events.
    """

    def __init__(
        self, model: LimbModel, *, c: float | ElementMap, kept: KeptSolves = NOTHING_KEPT,
        progress: Progress = SILENT,
    ):  # fmt: skip
        self._model, self._c, self._kept = model, c, kept
        # d kappa / d f_kappa for each cell: kappa = f_kappa c(x).
        self._weights = {(TISSUE, "kappa"): c.values} if isinstance(c, ElementMap) else {}
        self._session = ReferenceSession(model, progress=progress)
        self._progress = progress
        self.depths: Array = np.zeros(0)
        self.n_solves = self.n_kept = 0
        self.at_most: int | None = None

    def __call__(self, theta: Array, wrt: Sequence[int] = ()) -> Prediction:
        f_kappa, m = float(theta[0]), float(theta[1])
        model = with_tissue(self._model, c=self._c, f_kappa=f_kappa, m=m)
        self.n_solves += 1
        if (known := self._kept.forces(model)) is not None:
            self.n_kept += 1
            self.depths = known.depths
            return known.prediction
        self._progress.event("solve", number=self.n_solves, at_most=self.at_most)
        result = self._session.solve(model, wrt=[(TISSUE, "kappa"), (TISSUE, "m1-m2")], weights=self._weights)
        by_kappa, by_m = (result.force_gradient[(TISSUE, name)] for name in ("kappa", "m1-m2"))
        self.depths = result.must_points.depths
        by_f_kappa = by_kappa if isinstance(self._c, ElementMap) else self._c * by_kappa
        found = Prediction(result.must_points.forces, np.column_stack([by_f_kappa, by_m]))
        self._kept.keep_forces(model, KeptForces(self.depths, found))
        return found

    def share_of_c(self, theta: Array) -> Array:
        """d ln force / d ln c (n_levels,), exact."""
        model = with_tissue(self._model, c=self._c, f_kappa=float(theta[0]), m=float(theta[1]))
        numbers = model.materials[TISSUE].parameters
        rates = {(TISSUE, name): each for name, each in numbers.items() if name in ("c1", "c2", "kappa")}
        weights = {key: each.values for key, each in rates.items() if isinstance(each, ElementMap)}
        result = self._session.solve(model, wrt=list(rates), weights=weights)
        by_c = sum(
            result.force_gradient[key] * (each if isinstance(each, float) else 1.0)
            for key, each in rates.items()
        )
        return np.asarray(by_c / result.must_points.forces)

    def levels_at(self, theta: Array) -> Solved | None:
        """The levels at (or nearest to) theta among the latest solves, as initial guesses of others."""
        model = with_tissue(self._model, c=self._c, f_kappa=float(theta[0]), m=float(theta[1]))
        if (levels := self._kept.levels(model)) is not None:
            return levels
        if (levels := self._session.nearest_levels(model)) is not None:
            self._kept.keep_levels(model, levels)
        return levels

    def close(self) -> None:
        self._session.close()


# Width in I4 of the band over which the stiffness of fibres sets in as they begin to be stretched. On a limb
# with mu along the fibres twice that across, 0.05 lowers the force by about 5 %, 0.01 by 1 to 3 %; solves
# with 0.01 take hardly longer when they start from converged levels.
FIBRE_BAND = 0.01
# Relative residual that is accepted where the iterations stall: points at which fibres begin to be stretched
# can switch on and off from one iteration to the next.
_STALLED_WITH_FIBRES = 5e-4


class LawCurve:
    """Forces (n_levels,) N for any law as a function of its shape; then with `speeds` the mean speeds
    (n_levels,) m/s, then with `lines` the lines' depths below the skin (mm), level by level.

    Forces and lines have exact derivatives, speeds none. `depths` (n_levels,) mm is set by a solve.
    """

    def __init__(
        self, model: LimbModel, law: FitLaw, *, c: float, density_kg_per_m3: float, speeds: bool = True,
        lines: MaterialLines | None = None, progress: Progress = SILENT,
    ):  # fmt: skip
        if lines is not None:
            others = tuple(each for each in model.records if speeds or each.kind == "rigid_body")
            model = replace(model, records=(*others, lines.record))
        self._model, self.law, self._c, self._speeds, self._lines = model, law, c, speeds, lines
        self._density = density_kg_per_m3
        start = model.with_material(TISSUE, law.material(c, [each.start for each in law.shape]))
        self._progress = progress
        stalled = _STALLED_WITH_FIBRES if law.has_fibres else 0.0
        self._session = ReferenceSession(self._eased(start), progress=progress, stalled=stalled)
        self.depths: Array = np.zeros(0)
        self.n_solves = 0

    def _eased(self, model: LimbModel) -> LimbModel:
        """The model with the fibres' stiffness setting in over a band; wave speeds use the exact law."""
        return softer_jumps(model, FIBRE_BAND) if self.law.has_fibres else model

    def _solve(self, model: LimbModel, **options: Any) -> SessionResult:
        """Solve the smoothed model from converged levels; if that fails, from those with a wider band."""
        if not self.law.has_fibres:
            return self._session.solve(model, **options)
        if self._session.kept_levels is not None:
            with suppress(SolveError):
                return self._session.solve(self._eased(model), stop=StopWhen(patient=False), **options)
        self._session.solve(softer_jumps(model))
        return self._session.solve(self._eased(model), **options)

    def with_penalty(self, theta: Array, penalty: float) -> Array:
        """Forces (n_reached,) N with another contact penalty, from converged levels; SolveError if none is
        reached."""
        return self._again(with_penalty(self.fitted(theta), penalty))

    def with_boundary(self, theta: Array, boundary: ChangedBoundary) -> Array:
        """The same with another boundary and the same contact."""
        return self._again(boundary.of(self.fitted(theta)))

    def _again(self, model: LimbModel) -> Array:
        return CheckSolver(like=self._session, progress=self._progress).forces(model)

    def fitted(self, theta: Array) -> LimbModel:
        """The model with these parameters as it is solved."""
        return self._eased(self._model.with_material(TISSUE, self.law.material(self._c, theta)))

    def __call__(self, theta: Array, wrt: Sequence[int] = ()) -> Prediction:
        self.n_solves += 1
        material = self.law.material(self._c, theta)
        searched = self.law.searched(self._c, theta)
        model = self._model.with_material(TISSUE, material)
        result = self._solve(
            model, wrt=[(TISSUE, name) for name in searched], records=self._speeds,
            field_gradients=(LINES,) if self._lines is not None else False,
        )  # fmt: skip
        points = result.must_points
        self.depths = points.depths
        by_shape = sum(
            np.outer(result.force_gradient[(TISSUE, name)], slope) for name, slope in searched.items()
        )
        values, slopes = [points.forces], [np.asarray(by_shape)]
        rows = result.rows
        if self._speeds:
            values += [mean_speeds(model, result.simulation, rows, density_kg_per_m3=self._density)]
            slopes += [np.full((len(rows), len(theta)), np.nan)]
        if self._lines is not None:
            values += [self._lines.below_skin(result.simulation.nodes[LINES].column("uz")[rows]).ravel()]
            slopes += [_line_slopes(self._lines, result, searched)]
        return Prediction(np.concatenate(values), np.vstack(slopes))

    def close(self) -> None:
        self._session.close()


def _line_slopes(lines: MaterialLines, result: SessionResult, searched: Mapping[str, Array]) -> Array:
    """d line depth / d shape (n_levels * n_lines, n_shape); searched: d material parameter / d shape."""
    total: Array | float = 0.0
    for name, slope in searched.items():
        moved = result.field_gradient[(TISSUE, name)][LINES].column("uz") @ lines.weights.T
        total = total + np.multiply.outer(moved.ravel(), slope)
    return np.asarray(total)


class FileCurve:
    """Forces at the levels from a solver that works on files; every run has its own folder."""

    def __init__(
        self, solver: Solver, model: LimbModel, *, c: float | ElementMap, time_limit_s: float | None = None
    ):
        self._solver, self._model, self._c = solver, model, c
        self._limit = time_limit_s
        # times of the model's must-points, from the start of the analysis
        times, start = [], 0.0
        for step in model.steps:
            times += [start + each for each in step.must_points]
            start += step.n_steps * step.step_size
        self._times = np.array(times)
        self.depths: Array = np.zeros(0)

    def __call__(self, theta: Array) -> Array:
        return self._forces(self._c, theta)

    def share_of_c(self, theta: Array) -> Array:
        """d ln force / d ln c (n_levels,) by central differences: runs with stiffer and softer tissue."""

        def at(factor: Array) -> Array:
            return self._forces(_times(self._c, float(factor[0])), theta)

        up, down = self.run_side_by_side(at, [np.array([_C_STEP]), np.array([1.0 / _C_STEP])])
        return np.asarray(np.log(up / down) / (2.0 * np.log(_C_STEP)))

    def levels_at(self, _theta: Array) -> None:
        """None: a solver on files starts each run from rest."""

    def _forces(self, c: float | ElementMap, theta: Array) -> Array:
        with scratch_folder() as folder:
            model = with_tissue(self._model, c=c, f_kappa=float(theta[0]), m=float(theta[1]))
            feb = self._solver.write(model, folder)
            self._solver.run(feb, progress=SILENT, time_limit_s=self._limit)
            simulation = self._solver.read(feb)
        self.depths = at_levels(simulation, simulation.probe_depth(), self._times)
        return at_levels(simulation, simulation.probe_force(), self._times)

    def differentiable(self, *, relative_step: float = 0.05) -> Differences:
        """The curve with derivatives by forward differences, whose runs are made in parallel."""
        upper = (F_KAPPA_BOUNDS[1], M_BOUNDS[1])
        return Differences(self, upper=upper, relative_step=relative_step, run_all=self.run_side_by_side)

    def run_side_by_side(self, evaluate: Callable[[Array], Any], thetas: Iterable[Array]) -> Iterable[Any]:
        """Evaluate all thetas in parallel; the first error is raised once all have ended."""
        todo = list(thetas)
        processes, threads = shares(len(todo), available_cores())
        if isinstance(self._solver, FebioSolver):
            self._solver = replace(self._solver, threads=threads)
        with ThreadPoolExecutor(processes) as pool:
            return list(pool.map(evaluate, todo))
