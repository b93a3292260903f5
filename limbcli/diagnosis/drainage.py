"""Drainage of fluid from a site's tissue, from held indentations simulated by FEBio.

Each run is a fast ramp, and a hold while the biphasic tissue drains. Permeability times c is 1 mm^2/s, so
that the simulated time in s equals k c t in mm^2. Runs at a few depths give a site's drainage; they are
cached.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.config import available_cores, shares
from limbcli.diagnosis.curves.curve_plan import USUAL_M
from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.data.held_forces import HeldForces
from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.mesh_error.numerical_checks import Notes
from limbcli.effects import poroelasticity
from limbcli.effects.drainage import SPREADS, Drainage, HeldIndentation
from limbcli.effects.effect import Effect
from limbcli.errors import FitError, LimbError, SolveError
from limbcli.feb.settings import USUAL_PENALTY, schedule
from limbcli.files.temporary_folders import scratch_folder
from limbcli.model import Curve, LimbModel
from limbcli.model.npz_file import model_hash
from limbcli.progress import Progress
from limbcli.site_model.indentation_model import TRAVEL, indentation_model, starting_depth, with_penalty
from limbcli.solvers import choose
from limbcli.solvers.febio import FebioSolver
from limbcli.solvers.solve_folder import SolveFolder
from limbcli.solvers.solver import Simulation, Solver

NAME = poroelasticity.EFFECT.name
SHARES_OF_DEPTH = (1.0, 0.5, 0.25)
_LEAST_DEPTHS = 2
_TIME_LIMIT_S = 3600.0  # time limit of one simulation; a limb of 6,000 nodes takes a few minutes
RAMP = 0.2 * float(SPREADS[0])  # mm^2, duration of the ramp as k c t
END = float(SPREADS[-1])  # mm^2, end of the hold as k c t
_PER_DECADE = 3  # intervals of the largest time step per decade
# mm, largest indentation per step of the ramp: a larger fraction of an element inverts tet10. Failed
# simulations are repeated with the smaller step.
RAMP_STEPS = (0.5, 0.1)
_LEAST_STEP = 1e-2  # smallest time step, as a fraction of the first
LONGEST_STEP = "longest_step"
# Tolerances of `robust_step` except that of the residual; with these, holds of a limb of 6,000 nodes
# completed.
_CONTROL = {"dtol": 0.01, "etol": 0.01}


@dataclass(frozen=True)
class DrainageSolver:
    """solver : FEBio; always : simulate even if no force falls in a hold"""

    solver: Solver
    always: bool = False

    @staticmethod
    def chosen(kind: str, febio: Path | None) -> DrainageSolver | None:
        """FEBio, if `solvers.choose` gives it (or raises its errors): only it simulates drainage."""
        solver = choose(kind, febio)
        named = kind == FebioSolver.name
        return DrainageSolver(solver, named) if isinstance(solver, FebioSolver) else None


def drained(
    solver: DrainageSolver, held: HeldForces | None, simulations: SiteSimulations, *, deepest: float,
    keep: Path, notes: Notes, progress: Progress,
) -> Effect:  # fmt: skip
    """Poroelasticity with a site's drainage, from simulations at fractions of the depth `deepest` (mm), kept
    in the folder `keep`; facts on these go to the notes.

    Raises LimbError if there are no holds in which the force falls, or too few simulations succeed.
    """
    if held is None:
        why = notes.data.get("holds_not_used")
        lacking = f"it requires data that were not measured: hold{f' ({why})' if why else ''}"
        raise _refused(lacking, fix="record force and depth in holds (trace)")
    if not solver.always and (fallen := held.fallen(simulations.curves(USUAL_M))) < decisions.FALLEN_SD:
        steady = f"no force decrease in the holds ({fallen:.1f} deviations over all of them)"
        raise _refused(steady, fix="--solver febio evaluates it anyway")
    depths = [round(share * deepest, 2) for share in SHARES_OF_DEPTH]
    version = solver.solver.version()
    found = _runs(solver.solver, simulations, SolveFolder(keep), depths, version, progress)
    reports = [
        {"depth_mm": each.depth, "seconds": round(each.seconds, 1), "problem": each.problem or None}
        for each in found
    ]
    notes.data["drainage"] = {"solver": solver.solver.name, "solver_version": version, "runs": reports}
    drainage = Drainage.through(_enough(found))
    notes.warnings.extend(
        f"{NAME} was evaluated without FEBio's run at {each.depth:g} mm: {_first_line(each.problem)}"
        for each in found if each.hold is None
    )  # fmt: skip
    return poroelasticity.with_drainage(drainage)


@dataclass(frozen=True, eq=False)
class _Run:
    depth: float
    hold: HeldIndentation | None
    problem: str = ""
    seconds: float = 0.0


def _runs(
    solver: Solver, simulations: SiteSimulations, memo: SolveFolder, depths: Sequence[float], version: str,
    progress: Progress,
) -> list[_Run]:  # fmt: skip
    """Parallel simulations on the available cores, each in a separate folder; results are cached."""

    def held(depth: float, ramp_step: float = RAMP_STEPS[0]) -> LimbModel:
        return held_model(simulations.model, depth, c=simulations.c, m=USUAL_M, ramp_step=ramp_step)

    def kept(depth: float) -> _Run | None:
        def run_of(stored: Any) -> _Run:
            hold = HeldIndentation(depth, float(stored["ramp_mm2"]), stored["spread_mm2"], stored["force_n"])
            return _Run(depth, hold, "", float(stored["seconds"]))

        return memo.read(keys[depth], run_of)

    def run(depth: float) -> _Run:
        """Simulate one depth, with shorter steps if FEBio fails with longer ones."""
        started, problem, hold = time.monotonic(), "", None
        for ramp_step in RAMP_STEPS:
            try:
                with scratch_folder() as folder:
                    feb = solver.write(held(depth, ramp_step), folder)
                    solver.run(feb, progress=progress, time_limit_s=_TIME_LIMIT_S)
                    hold = hold_of(solver.read(feb), depth)
                break
            except SolveError as error:
                problem = problem or error.what
            except LimbError as error:  # shorter steps would not help
                problem = error.what
                break
        found = _Run(depth, hold, "" if hold else problem, time.monotonic() - started)
        if hold is not None:
            content = {"spread_mm2": hold.spread, "force_n": hold.force, "ramp_mm2": hold.ramp}
            memo.write(keys[depth], {**content, "seconds": found.seconds})
        return found

    keys = {depth: f"drainage-{model_hash(held(depth))[:16]}-{version}" for depth in depths}
    known = {depth: kept(depth) for depth in depths}
    todo = [depth for depth in depths if known[depth] is None]
    processes, threads = shares(len(todo), available_cores())
    if isinstance(solver, FebioSolver):
        solver = replace(solver, threads=threads)
    if todo:
        at = ", ".join(f"{each:g}" for each in todo)
        progress.event("note", text=f"FEBio simulates held biphasic tissue at {at} mm (minutes each)")
    with ThreadPoolExecutor(processes) as pool:
        fresh = dict(zip(todo, pool.map(run, todo), strict=True))
    return [known[depth] or fresh[depth] for depth in depths]


def _enough(found: Sequence[_Run]) -> list[HeldIndentation]:
    """The completed holds; SolveError if there are fewer than two, which do not determine other depths."""
    holds = [each.hold for each in found if each.hold is not None]
    if len(holds) >= _LEAST_DEPTHS:
        return holds
    failed = next(each for each in found if each.hold is None)
    raise SolveError(
        f"FEBio completed the drainage at only {len(holds)} of {len(found)} depths: "
        f"{_first_line(failed.problem)}",
        where=f"effect {NAME}", fix="another --size-mm, or check the site's mesh",
    )  # fmt: skip


def _first_line(text: str) -> str:
    return text.splitlines()[0].rstrip(":") if text else ""


def _refused(why: str, *, fix: str) -> FitError:
    return FitError(why, where=f"effect {NAME}", fix=fix)


def held_model(
    meshed: LimbModel, depth: float, *, c: float, m: float, ramp_step: float = RAMP_STEPS[0]
) -> LimbModel:
    """Held model of a site at one depth (mm); c in MPa; drained f_kappa as in the effect.

    meshed : the site's model as `mesh` makes it; ramp_step : mm, largest step of the ramp
    """
    start = starting_depth(meshed, depth)
    model = indentation_model(meshed, schedule([depth], start=start), c=c, f_kappa=100.0, m=m)
    theta = {**poroelasticity.with_permeability(1.0 / c), **poroelasticity.EFFECT.grid[0]}
    biphasic = poroelasticity.apply(with_penalty(model, USUAL_PENALTY), theta)
    first = RAMP / np.ceil((depth - start) / ramp_step)
    edges = np.geomspace(RAMP, END, round(_PER_DECADE * np.log10(END / RAMP)) + 1)
    times = [0.0, *(float(f"{each:.4g}") for each in edges)]
    largest = [first, *(np.diff(edges).tolist()), float(edges[-1] - edges[-2])]
    n_steps = int(np.ceil(times[-1] / first))
    step = replace(
        biphasic.steps[0], n_steps=n_steps, step_size=times[-1] / n_steps, dt_min=_LEAST_STEP * first,
        must_points=(), dt_max_curve=LONGEST_STEP, control={**biphasic.steps[0].control, **_CONTROL},
    )  # fmt: skip
    travel = depth - start
    curves = {
        TRAVEL: Curve(((0.0, 0.0), (times[1], travel), (times[-1], travel))),
        LONGEST_STEP: Curve(tuple(zip(times, largest, strict=True)), interpolate="step"),
    }
    return replace(biphasic, curves=curves, steps=(step,), records=biphasic.records[:1])


def hold_of(simulation: Simulation, depth: float) -> HeldIndentation:
    """Force over time of a finished simulation of `held_model`."""
    later = simulation.times > 0
    return HeldIndentation(depth, RAMP, simulation.times[later], simulation.probe_force()[later])
