"""run: simulate the indentation with FEBio or the reference solver; both give the same files."""

from __future__ import annotations

import shlex
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from limbcli.case import Case, Site
from limbcli.case.schema import FAILED
from limbcli.errors import CaseError, LimbError, SolveError
from limbcli.feb.outline import Outline, read_outline
from limbcli.feb.read import read_feb
from limbcli.feb.runnable import Runnable, runnable
from limbcli.files.atomic import atomic_folder, sha256
from limbcli.measurement.indentation import Levels
from limbcli.progress import PROGRESS_FILE, SILENT, Progress, recorded
from limbcli.provenance.chain_inputs import noted
from limbcli.provenance.requested_options import requested_by_options
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, StageWriter, open_stage, plain, stage_folder
from limbcli.site_model.site_levels import levels_of
from limbcli.solvers import choose
from limbcli.solvers.cautions import cautions
from limbcli.solvers.febio import FebioSolver, plot_file
from limbcli.solvers.reference import NAME as REFERENCE
from limbcli.solvers.restart import RESTART_FILE
from limbcli.solvers.solver import LOG_FILE, MODEL_FILE, Solver
from limbcli.stages.running.files import write_simulation
from limbcli.stages.running.vtu import write_series

STAGE = "run"
_OF_A_CASE = ("segment", "mesh", "build-feb", "fit")  # stages whose results show that a folder is a case's


@dataclass(frozen=True)
class RunOptions:
    """time_limit_s : time limit of each simulation; vtu : also write a time series for ParaView;
    keep_plot : keep FEBio's plot file.
    """

    time_limit_s: float | None = None
    vtu: bool = False
    keep_plot: bool = False


def run(
    case: Case, *, out: Path, sites: list[str] | None = None, solver: str = "auto", febio: Path | None = None,
    options: RunOptions = RunOptions(), progress: Progress = SILENT,
) -> list[StageResult]:  # fmt: skip
    """Run each site's model.

    Writes model.feb, model.log, the record files, force-depth.csv and force-depth.png.
    A run that fails or is stopped leaves its model, its log and a run.json with the reason in
    `<site>-failed`; the reference solver continues from there when the same model is run again.

    Raises as `limbcli.run`.
    """
    runner = _Runner.of(solver, febio, options, progress)
    results = []
    for site in case.selected(sites):
        progress.event("stage", name=STAGE, site=site.name)
        results.append(_run_site(case, site, out, runner))
    return results


def run_file(
    feb: Path, *, out: Path, solver: str = "auto", febio: Path | None = None,
    options: RunOptions = RunOptions(), progress: Progress = SILENT,
) -> StageResult:  # fmt: skip
    """Run a model file that belongs to no case; the result is `<out>/run`. Raises as `limbcli.run_feb`."""
    # a file's result would replace `run/` of all sites
    stages = [stage_folder(out, each) for each in _OF_A_CASE]
    found = [
        *(each for each in stages if each.is_dir()),
        *sorted(stage_folder(out, STAGE).glob("*/run.json")),
    ]
    if found:
        raise CaseError(
            "the output folder holds the results of a case, whose runs those of a file would replace",
            where=str(found[0]),
            fix=f"give another folder: limbcli run {shlex.quote(str(feb))} --out FOLDER",
        )
    runner = _Runner.of(solver, febio, options, progress)
    model = runnable(feb)
    progress.event("stage", name=f"{STAGE} {feb.name}", site=None)
    with open_stage(out, STAGE, subject=model_name(feb)) as writer:
        _simulate(feb, model, writer, runner)
    shutil.rmtree(out / f"{STAGE}{FAILED}", ignore_errors=True)
    return writer.result


@dataclass(frozen=True, eq=False)
class _Runner:
    """What runs the models, and how."""

    engine: Solver
    options: RunOptions
    progress: Progress

    @staticmethod
    def of(solver: str, febio: Path | None, options: RunOptions, progress: Progress) -> _Runner:
        engine = choose(solver, febio)
        if options.keep_plot:
            if not isinstance(engine, FebioSolver):
                raise CaseError(
                    f"the {engine.name} solver writes no plot file (.xplt); only FEBio does",
                    where="--keep-plot",
                    fix="omit --keep-plot and take --vtu, or install FEBio and give its binary with "
                    "--febio FILE",
                )
            engine = replace(engine, keep_plot=True)
        return _Runner(engine, options, progress)


def model_name(feb: Path) -> str:
    """
    >>> model_name(Path("models/S1.v2.feb")), model_name(Path("S1.feb.gz"))
    ('S1.v2', 'S1')
    """
    return feb.name.removesuffix(".gz").removesuffix(".feb")


def _run_site(case: Case, site: Site, out: Path, runner: _Runner) -> StageResult:
    built = Chain(case, out).result("build-feb", site=site.name)
    feb = built.folder / MODEL_FILE
    if not feb.is_file():
        raise CaseError(
            f"{MODEL_FILE} is missing", where=str(built.folder), fix="run `limbcli build-feb` again"
        )
    with open_stage(out, STAGE, subject=case.subject, site=site.name) as writer:
        site = noted(case, writer).site(site.name)
        levels = levels_of(site)
        writer.warnings.extend(built.warnings)
        writer.used_result(built, files=["feb"])
        writer.data["asked"] = requested_by_options(runner.options)
        _simulate(feb, runnable(feb), writer, runner, levels=levels, site=site)
    shutil.rmtree(stage_folder(out, STAGE, site.name + FAILED), ignore_errors=True)
    return writer.result


def _simulate(
    source: Path, model: Runnable, writer: StageWriter, runner: _Runner, *, levels: Levels | None = None,
    site: Site | None = None,
) -> None:  # fmt: skip
    engine, options, progress = runner.engine, runner.options, runner.progress
    feb = writer.file("feb", MODEL_FILE)
    feb.write_bytes(model.text)
    writer.used("model", source)
    outline = _outline(feb, source)
    for sentence in model.said:
        progress.event("note", text=sentence)
    writer.summary.extend(model.said)
    if site is None and not outline.has_touch_frame:
        for sentence in _cautions(feb):
            progress.event("note", text=sentence)
            writer.warnings.append(sentence)
    if options.vtu:
        _check_readable(feb, source)
    progress.event("note", text=f"solver: {engine.name} {_version(engine)}")
    stopped = writer.target.with_name(writer.target.name + FAILED) / RESTART_FILE
    if engine.name == REFERENCE and stopped.is_file():
        shutil.copy2(stopped, writer.work / RESTART_FILE)
    events = writer.file("progress", PROGRESS_FILE)
    with recorded(progress, events) as heard:
        try:
            engine.run(feb, progress=heard, time_limit_s=options.time_limit_s)
            simulation = engine.read(feb)
        except SolveError as error:
            raise _kept(error, writer, engine) from error
        except LimbError as error:
            raise _of_source(error, feb, source) from error
        except KeyboardInterrupt:
            stopped_by_hand = SolveError("the run was interrupted", where=str(feb), fix="run it again")
            _keep(writer, stopped_by_hand, engine)
            raise
    writer.files["log"] = LOG_FILE
    if options.keep_plot:
        if (feb.parent / plot_file(feb)).is_file():
            writer.files["plot"] = plot_file(feb)
        else:
            writer.warnings.append("FEBio wrote no plot file: <Output> of the model has no <plotfile>")
    for record in outline.records:
        writer.files[Path(record.file).stem] = record.file
    write_simulation(simulation, outline, writer, levels=levels, site=site)
    if options.vtu:
        write_series(feb, simulation, writer)
    writer.data["model_sha256"] = sha256(feb)


def _outline(feb: Path, source: Path) -> Outline:
    try:
        return read_outline(feb)
    except CaseError as error:
        raise _of_source(error, feb, source) from error


def _cautions(feb: Path) -> tuple[str, ...]:
    """What a model means otherwise than may be expected; nothing of one that limbcli cannot read."""
    try:
        return cautions(read_feb(feb))
    except CaseError:
        return ()


def _check_readable(feb: Path, source: Path) -> None:
    """Check before the run that limbcli can read the model, as a time series requires; FEBio reads more."""
    try:
        read_feb(feb)
    except CaseError as error:
        own = _of_source(error, feb, source)
        fix = f"{own.fix}, without --vtu"
        raise CaseError(own.what, where=own.where, fix=fix, **own.facts) from error


def _version(engine: Solver) -> str:
    version = engine.version()
    return version if version != "unknown" else "of unknown version (it reported none; its log will)"


def _keep(writer: StageWriter, error: LimbError, engine: Solver) -> Path:
    """Copy a failed run's files and a run.json with the reason to `<site>-failed`; return that folder."""
    folder = writer.target.with_name(writer.target.name + FAILED)
    failure = {"error": type(error).__name__, "what": error.what, "where": error.where, "fix": error.fix}
    writer.data.update(solver=engine.name, failed=True, failure={**failure, "facts": plain(error.facts)})
    writer.warnings.append(f"the run failed: {error.what.splitlines()[0]}")
    writer.files = {name: file for name, file in writer.files.items() if (writer.work / file).is_file()}
    writer.finish()
    with atomic_folder(folder) as kept:
        for path in writer.work.iterdir():
            if path.is_file():
                shutil.copy2(path, kept / path.name)
    return folder


def _kept(error: LimbError, writer: StageWriter, engine: Solver) -> LimbError:
    """Keep a failed run's files; return the same error, naming the folder that holds them."""
    folder = _keep(writer, error, engine)
    where = f"{writer.site or writer.subject}: {folder / LOG_FILE}"
    place = error.where.replace(str(writer.work), str(folder))
    if place != str(folder / LOG_FILE):
        where += f"; {place}"
    return type(error)(error.what, where=where, fix=error.fix, **error.facts)


def _of_source(error: LimbError, feb: Path, source: Path) -> LimbError:
    """The same error, naming the user's file instead of the copy that was run."""
    what, where, fix = (text.replace(str(feb), str(source)) for text in (error.what, error.where, error.fix))
    return type(error)(what, where=where, fix=fix, **error.facts)
