"""The bundled reference solver: reads a `.feb` file and writes the same result files as FEBio.

`ReferenceSolver` implements the common solver interface; `limbcli.solvers.session` keeps a model in memory.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from limbcli.config import at_most
from limbcli.errors import SolveError
from limbcli.feb.log_identity import marked
from limbcli.feb.outline import check_output_levels, read_outline
from limbcli.feb.read import IGNORED, read_feb
from limbcli.feb.write import write_feb
from limbcli.model import IntArray, LimbModel
from limbcli.progress import SILENT, Progress
from limbcli.solvers.record_tables import read_finished
from limbcli.solvers.reference_files import RunFiles
from limbcli.solvers.restart import Restart
from limbcli.solvers.solver import LOG_FILE, MODEL_FILE, Simulation
from limbcli.solvers.untouched import without_force
from limbcli.version import __version__

if TYPE_CHECKING:
    from limbcli.fem.analysis import Analysis, Snapshot
    from limbcli.fem.linear_solvers.direct import LinearSolver
    from limbcli.fem.warm_start import Solved

NAME = "reference"
_SMOOTH_TOLERANCE = 1e-11  # relative residual without contact, where quadratic convergence makes it cheap
# Relative residual accepted on stagnation with friction, as a multiple of the tolerance. Rims are sharp with
# friction: the traction of a point jumps as it slides off, so an equilibrium to the full tolerance may not
# exist.
_STALLED_WITH_FRICTION = 100.0
_AT_THE_END = 1e-6  # relative difference from the end time that is round-off of the summed steps


@dataclass
class ReferenceSolver:
    """The reference solver behind the common interface.

    threads : number of threads
    linear : "auto" (our own "multifrontal"), "pardiso" or "superlu"
    tolerance : relative residual (norm of the residual over norm of the acting forces)
    """

    threads: int = 2
    linear: str = "auto"
    tolerance: float = 1e-6
    name: str = NAME

    def found(self) -> bool:
        return True

    def version(self) -> str:
        return __version__

    def identity(self) -> str:
        return self.name

    def write(self, model: LimbModel, folder: Path) -> Path:
        return write_feb(model, folder / MODEL_FILE)

    def run(self, feb: Path, *, progress: Progress, time_limit_s: float | None = None) -> None:
        """Solve a model file in its folder; the log and the record files are written next to it.

        A run that is stopped leaves its converged levels there, and the next run of the same file
        resumes from them.

        Raises CaseError or SolveError if the file uses an unsupported feature (before anything is computed),
        if a level is not reached, or if the time limit is exceeded before the end is reached.
        """
        model = read_feb(feb)
        left_out = "; ".join(model.info.get(IGNORED, ()))
        if left_out:
            progress.event("note", text=f"left out of {feb.name}: {left_out}")
        outline, mark = read_outline(feb), marked(feb, ".feb")
        check_output_levels(outline, feb)
        with RunFiles(model, feb.parent, outline=outline, version=self.version(), mark=mark) as files:
            files.note(f"left out: {left_out}" if left_out else "")
            if fewer := _only_must_points(model):
                files.note(fewer) if outline.has_touch_frame else files.warning(fewer)
            self._compute(model, files, self._restart(feb), progress, time_limit_s)

    def begin_with(self, feb: Path, levels: Solved) -> None:
        """Let the next run of a model file start from these levels, solved in memory, instead of from rest.

        A level that is in equilibrium takes one evaluation of the forces; another one is solved from there.
        """
        self._restart(feb).begin_with(levels.states)

    def _restart(self, feb: Path) -> Restart:
        return Restart(feb.parent, feb.read_bytes(), f"tolerance {self.tolerance:g}")

    def _compute(
        self,
        model: LimbModel,
        files: RunFiles,
        restart: Restart,
        progress: Progress,
        time_limit_s: float | None,
    ) -> None:
        analysis = prepare(
            model, progress, threads=self.threads, linear=self.linear, tolerance=self.tolerance
        )
        started = time.monotonic()
        if restart.n_stored:
            progress.event("note", text=f"starting from {restart.n_stored} levels that are already solved")

        names, touched, poses = [body.name for body in model.bodies], [False], []
        end = sum(step.n_steps * step.step_size for step in model.steps)

        def visit(running: Analysis, snapshot: Snapshot) -> None:
            files.step(running, snapshot)
            restart.keep(snapshot.state)
            touched[0] |= snapshot.forces.n_touching > 0
            poses.append(dict(zip(names, snapshot.state.bodies, strict=True)))
            reached = snapshot.state.time
            late = time_limit_s is not None and time.monotonic() - started > time_limit_s
            if late and reached < end * (1.0 - _AT_THE_END):
                raise SolveError(
                    f"the reference solver was stopped after {time_limit_s:g} s, at time {reached:g}",
                    where=str(files.folder / LOG_FILE),
                    fix="run again to resume from there, with a longer --time-limit-s, or use --element tet4",
                    time_reached=reached,
                )

        try:
            analysis.run(visit, guesses=restart.guess)
            for sentence in () if touched[0] else without_force(model, poses):
                files.warning(sentence)
                progress.event("note", text=sentence)
            files.finish(analysis, time.monotonic() - started)
            restart.finished()
        finally:
            analysis.close()

    def read(self, feb: Path) -> Simulation:
        """The results of a finished run, from the files next to its model file."""
        return read_finished(self.name, feb)


def _only_must_points(model: LimbModel) -> str:
    """What is left out of the records of a model with must-points; "" if nothing."""
    from limbcli.fem.equilibrium.solve_times import counts_every_step

    left_out = [step for step in model.steps if step.must_points and not counts_every_step(step)]
    if model.remembers or not left_out:
        return ""
    return "only must-points and ends of steps are solved for and written; FEBio writes every time step"


def prepare(
    model: LimbModel,
    progress: Progress = SILENT,
    *,
    threads: int = 2,
    linear: str = "auto",
    tolerance: float = 1e-6,
    stalled: float = 0.0,
    slip_as_febio: bool = False,
) -> Analysis:
    """An analysis of a model, after checking that all of its features are supported."""
    from limbcli.fem.supported import check_supported, refuse_without_stiffness, warm_up

    check_supported(model)
    warm_up(progress)
    refuse_without_stiffness(model)
    from limbcli.fem.analysis import Analysis
    from limbcli.fem.equilibrium.settings import Settings

    if not model.contacts:
        tolerance = min(tolerance, _SMOOTH_TOLERANCE)
    if model.has_friction:
        stalled = max(stalled, _STALLED_WITH_FRICTION * tolerance)
    settings = Settings(
        tolerance=tolerance,
        linear=linear,
        threads=at_most(threads),
        stalled=stalled,
        slip_as_febio=slip_as_febio,
    )
    return Analysis(model, settings, progress)


def kernels_are_there() -> bool:
    """Whether the solver's kernels have been compiled on this machine before."""
    from limbcli.fem.supported import are_there

    return are_there()


def direct_solver(indptr: IntArray, indices: IntArray, *, single: bool) -> LinearSolver:
    """The default direct solver for a matrix pattern (upper triangle, CSR)."""
    from limbcli.fem.linear_solvers.direct import make

    return make(indptr, indices, single=single)
