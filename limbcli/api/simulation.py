"""build_feb and run: write the FEBio model, and simulate it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from limbcli.api.call import CaseLike, Heard, PathLike, at_work, folder_of, maybe_path, writing
from limbcli.api.stage_result import Result, each_site, one
from limbcli.api.tables import Table, plain_rows, read_columns, structured
from limbcli.errors import CaseError
from limbcli.options import (
    C_KPA,
    CASE,
    FEBIO,
    OUT,
    PROGRESS,
    SITES,
    SOLVER,
    TEMPLATES,
    WAIT,
    Option,
    SolverName,
)  # fmt: skip
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.model import LimbModel

TIME_LIMIT = Option("Time limit of each simulation; default: by the model's size.", (0, None))
VTU = Option("Also write a time series for ParaView.")
KEEP_PLOT = Option("Keep FEBio's plot file (model.xplt), for FEBio Studio.")


@dataclass(frozen=True, eq=False)
class BuildFebResult(Result):
    """The FEBio model of a site. `table()` has one row.

    Attributes
    ----------
    feb : the model file, FEBio 4.0
    c_kpa : c = 2 mu
    c_source : origin of c, in words
    f_kappa, m, kappa_kpa : start values of the law, kappa' = f_kappa c
    element : "tet10" or "tet4"
    n_nodes, n_elements : of the tissue
    """

    stage: ClassVar[str] = "build-feb"
    feb: Path
    c_kpa: float
    c_source: str
    f_kappa: float
    m: float
    kappa_kpa: float
    element: str
    n_nodes: int
    n_elements: int

    def rows(self) -> list[dict[str, Any]]:
        return [self._named(self._fields("feb"))]

    def model(self) -> LimbModel:
        """The model file, read back."""
        from limbcli.feb.read import read_feb

        return read_feb(self.feb)


@dataclass(frozen=True, eq=False)
class RunResult(Result):
    """A simulation. `table()` has one row per converged step: time_s, depth_mm, force_n.

    Attributes
    ----------
    solver, solver_version : the solver used
    n_steps, n_iterations : converged steps, and total number of Newton iterations
    solve_s : solution time in seconds
    max_depth_mm, max_force_n : of the probe; None if no rigid body logs them
    """

    stage: ClassVar[str] = "run"
    solver: str
    solver_version: str
    n_steps: int
    n_iterations: int
    solve_s: float = field(metadata={"from": "solve_seconds"})
    max_depth_mm: float | None
    max_force_n: float | None

    def curve(self) -> Table:
        """The force-depth curve: fields time_s, depth_mm, force_n, (n_steps,); empty if there is none."""
        path = self.files.get("force_depth")
        return structured([]) if path is None else read_columns(path)

    def rows(self) -> list[dict[str, Any]]:
        return [self._named(row) for row in plain_rows(self.curve())]


@each_site(BuildFebResult)
def build_feb(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    c_kpa: Annotated[float | None, C_KPA] = None,
    f_kappa: Annotated[float, Option("kappa' / c.", (0.01, 1000))] = 100.0,
    m: Annotated[float, Option("Exponent of the law.", (1, 100))] = 2.0,
    layers: Annotated[
        Mapping[str, Mapping[str, Any]] | None,
        Option(
            "Law of a layer, such as fat:c_kpa=2,f_kappa=100,m=2 or skin:law=neo_hooke,c_kpa=40; default: "
            "the case's, else assumed values. May be repeated.",
            flag="--layer",
            metavar="NAME:KEY=VALUE,...",
            kind=list[str],
            such_as=("fat:", "skin:"),
            python='By "skin" or "fat" a table of law, c_kpa, f_kappa, m, beta; default: the case\'s, else '
            "assumed values.",
        ),
    ] = None,
    contact_penalty: Annotated[
        float | None,
        Option(
            "Contact penalty, as a multiple of the skin's stiffness at rest; default: 20, with which FEBio "
            "converges. Use a higher one if fit warns that the probe sinks in.",
            (1, 1000),
        ),
    ] = None,
    abaqus: Annotated[
        bool, Option("Also write model.inp, the same model for Abaqus with its nearest material law.")
    ] = False,
    templates: Annotated[PathLike | None, TEMPLATES] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> Iterable[StageResult]:
    """Write mesh and measurement as a FEBio model of each site. Requires `mesh`.

    Raises
    ------
    CaseError
        If `mesh` has not been run since its inputs changed, or a template or argument is invalid.
    MeasurementError
        If the levels cannot be used, or c is neither measured nor given.

    Source: FEBio user manual 4, "Ogden unconstrained".
    """
    from limbcli.stages import build_feb as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = stage.TissueOptions(
            c_kpa=c_kpa, f_kappa=f_kappa, m=m, layers=_laws(layers or {}), contact_penalty=contact_penalty,
            abaqus=abaqus,
        )  # fmt: skip
        return work.run(stage.build_feb, sites=sites, options=options, templates=templates)


def _laws(layers: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The laws, checked against the rules of case.toml."""
    from limbcli.site_model.site_layers import parse_law

    if not isinstance(layers, Mapping) or not all(isinstance(each, Mapping) for each in layers.values()):
        fix = 'give a table of tables such as {"fat": {"c_kpa": 2.0}}'
        raise CaseError(f"layers is {layers!r}", where="build_feb(layers=...)", fix=fix)
    texts = (
        f"{name}:" + ",".join(f"{key}={value}" for key, value in table.items())
        for name, table in layers.items()
    )
    return dict(map(parse_law, texts))


@each_site(RunResult)
def run(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    solver: Annotated[SolverName, SOLVER] = "auto",
    febio: Annotated[PathLike | None, FEBIO] = None,
    time_limit_s: Annotated[float | None, TIME_LIMIT] = None,
    vtu: Annotated[bool, VTU] = False,
    keep_plot: Annotated[bool, KEEP_PLOT] = False,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> Iterable[StageResult]:
    """Simulate the indentation of each site with its start values. Requires `build_feb`.

    Raises
    ------
    CaseError
        If `build_feb` has not been run since its inputs changed, or an argument is invalid.
    ToolError
        If FEBio is requested and not found.
    SolveError
        If the end of the load is not reached; the partial results are in <site>-failed.
    """
    from limbcli.stages import run as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        return work.run(
            stage.run, sites=sites, solver=solver, febio=febio,
            options=stage.RunOptions(time_limit_s=time_limit_s, vtu=vtu, keep_plot=keep_plot),
        )  # fmt: skip


@one(RunResult)
def run_feb(
    feb: Annotated[PathLike, Option("A .feb or .feb.gz file, as docs/solvers.md describes.")],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    solver: Annotated[SolverName, SOLVER] = "auto",
    febio: Annotated[PathLike | None, FEBIO] = None,
    time_limit_s: Annotated[float | None, TIME_LIMIT] = None,
    vtu: Annotated[bool, VTU] = False,
    keep_plot: Annotated[bool, KEEP_PLOT] = False,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> StageResult:
    """Simulate a user-supplied FEBio model.

    Raises
    ------
    CaseError
        If the file cannot be read, or contains an unsupported part of FEBio's format.
    ToolError
        As `run`.
    SolveError
        As `run`, or if the file contains what the reference solver does not support.
    """
    from limbcli.stages import run as stage

    file = folder_of(feb, "feb")
    with writing(Path(stage.model_name(file)), out, wait=wait, progress=progress) as (target, heard):
        return stage.run_file(
            file, out=target, solver=solver, febio=maybe_path(febio, "febio"),
            options=stage.RunOptions(time_limit_s=time_limit_s, vtu=vtu, keep_plot=keep_plot), progress=heard,
        )  # fmt: skip
