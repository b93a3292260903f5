"""Commands whose options, or what they print, are other than those of the functions of `api`."""

from __future__ import annotations

import inspect
import itertools
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from limbcli.api.call import at_work
from limbcli.cli.output import say
from limbcli.cli.terminal import emit, emit_json
from limbcli.errors import CaseError
from limbcli.options import CASE, FEBIO, Option
from limbcli.progress import Progress
from limbcli.results import StageResult


def check_case(case: Annotated[Path, CASE], *, json: bool, progress: Progress) -> None:
    """Check a case folder and list every problem: files, units, ranges, missing entries."""
    from limbcli.errors.pasted_commands import pasted_text
    from limbcli.stages.check import check

    result = check(case, progress=progress)
    if json:
        emit_json(result.to_json())
    else:
        say(f"{case}: looked at {', '.join(result.looked_at)}")
        for line in result.shown:
            say(line)
        for k, problem in enumerate(result.problems, 1):
            say(f"{k}. {problem.severity}: {pasted_text(str(problem), case)}")
        n_errors = sum(each.severity == "error" for each in result.problems)
        to_correct = f"{n_errors} error{'s' if n_errors > 1 else ''} to correct"
        say(to_correct if n_errors else "the case is complete")
    raise typer.Exit(result.exit_code)


_MARKS = {"good": "  ", "note": "- ", "missing": "! "}


def check_machine(*, febio: Annotated[Path | None, FEBIO] = None, json: bool, progress: Progress) -> None:
    """Check this machine for limbcli's requirements: versions, libraries, solvers with a self test, memory.

    Exit code 4 if a requirement is missing; every such line gives the fix.
    """
    from limbcli.stages.doctor import doctor

    result = doctor(febio=febio, progress=progress)
    if json:
        emit_json(result.to_json())
    else:
        for topic, findings in itertools.groupby(result.findings, key=lambda each: each.topic):
            say(topic)
            for each in findings:
                say(f"{_MARKS[each.state]}{each.name}: {each.found}")
                if each.fix:
                    say(f"    fix: {each.fix}")
        n = len(result.missing)
        say("all requirements are met" if not n else f"{n} missing or broken, marked with !")
    raise typer.Exit(result.exit_code)


def new_case(
    folder: Annotated[Path, Option("Case folder to create; absent or empty.", metavar="DIR", kind=Path)],
    *,
    sites: Annotated[
        list[str] | None,
        Option(
            "Name of a measured site (may be repeated); default: p1.",
            flag="--site",
            short="-s",
            metavar="NAME",
            kind=list[str],
        ),
    ] = None,
) -> StageResult:
    """Create a case folder to fill in: commented case.toml, levels.csv, and a README that says where data go.

    Existing files are never changed: a folder that is not empty is rejected.
    """
    from limbcli.stages.new import new

    return new(folder, sites=tuple(sites or ["p1"]))


def segment_case(case: Annotated[Path, CASE], *, json: bool, **options: Any) -> None:
    """Segment an MRI or CT series, a label map or surfaces into skin, bones, fat and markers.

    A label map edited by hand in the output folder (labels.nii.gz) takes precedence over the automatic one.
    If a site is not on the skin, the command ends with an error after everything is written.
    """
    from limbcli.api.geometry import segment
    from limbcli.case import CASE_FILE
    from limbcli.errors import CaseError
    from limbcli.errors.problems import raise_errors
    from limbcli.stages.segmenting.possible_sites import site_errors

    result = inspect.unwrap(segment)(case, **options)
    emit(result, as_json=json)
    raise_errors(site_errors(result.data, str(case / CASE_FILE)), CaseError)


def run_case_or_file(
    case: Annotated[
        Path | None, Option("Case folder, or a FEBio model of your own.", metavar="CASE|FILE.feb", kind=Path)
    ] = None,
    *,
    feb: Annotated[Path | None, Option("A FEBio model instead of a case.", metavar="FILE", kind=Path)] = None,
    sites: list[str] | None,
    **options: Any,
) -> StageResult | list[StageResult]:
    """Simulate the indentation with FEBio, or with the bundled reference solver."""
    from limbcli.api.simulation import run, run_feb

    file = feb or (case if case is not None and is_model_file(case) else None)
    if file is not None and (case is None or file == case):
        if sites:
            raise CaseError(
                "a model file has no sites", where="--site", fix="omit --site, or give a case folder"
            )
        return inspect.unwrap(run_feb)(file, **options)
    if case is None or feb is not None:
        raise CaseError(
            "give either a case folder or one model file",
            where="limbcli run",
            fix="limbcli run CASE, or limbcli run FILE.feb",
        )
    return list(inspect.unwrap(run)(case, sites=sites, **options))


def is_model_file(path: Path) -> bool:
    """
    >>> is_model_file(Path("model.feb.gz")), is_model_file(Path("cases/phantom"))
    (True, False)
    """
    return path.name.endswith((".feb", ".feb.gz"))


def fit_by_objective(
    case: Annotated[Path, CASE],
    *,
    objective: Annotated[
        Literal["force", "joint", "states"],
        Option(
            "What to fit. force: the force-depth curve of each site, as in the paper. joint: depths and wave "
            "speeds of all sites, which share one tissue. states: the same for the states of one site.",
            before="gain_deviation_fraction",
        ),
    ] = "force",
    compare_element: Annotated[
        bool, Option("Compare tet4 and tet10 on the same mesh.", before="templates")
    ] = False,
    out: Path | None,
    sites: list[str] | None,
    solver: str,
    febio: Path | None,
    c_deviation_fraction: float | None,
    gain_deviation_fraction: float | None,
    wait: bool,
    progress: Progress,
    **others: Any,
) -> StageResult | list[StageResult]:
    """Identify f_kappa and m of each site from its force-depth curve (c from SWE)."""
    from limbcli.stages.fit import FitOptions, check_choice, fit

    options = FitOptions(c_deviation=c_deviation_fraction, gain_deviation=gain_deviation_fraction, **others)
    check_choice(objective, options, compare_element=compare_element, solver=solver, febio=febio)
    with at_work(case, out, wait=wait, progress=progress) as work:
        common: dict[str, Any] = {"out": work.out, "sites": sites, "options": options, "progress": progress}
        if compare_element:
            from limbcli.stages.fit_elements import compare_elements

            return compare_elements(work.case, **common)
        if objective == "joint":
            from limbcli.stages.fit_joint import fit_joint

            return fit_joint(work.case, **common)
        results = fit(work.case, solver=solver, febio=febio, **common) if objective == "force" else []
        if objective == "states" or any(each.states for each in work.case.selected(sites)):
            from limbcli.stages.fit_states import fit_states

            results += fit_states(work.case, **common)
        return results


def report_case_or_index(
    case: Annotated[
        Path | None, Option("Case folder (containing case.toml).", metavar="CASE", kind=Path)
    ] = None,
    *,
    index: Annotated[
        Path | None,
        Option(
            "Instead of one subject's page: a page that lists all subjects whose results lie in DIR.",
            metavar="DIR",
            kind=Path,
            before="templates",
        ),
    ] = None,
    open_page: Annotated[
        bool, Option("Open the page in the browser.", flag="--open", before="templates")
    ] = False,
    out: Path | None,
    templates: Path | None,
    wait: bool,
    json: bool,
    progress: Progress,
) -> None:
    """Write one self-contained page of the stages' results, or an index of many subjects."""
    from limbcli.api.diagnosis import report

    if (case is None) == (index is None):
        raise typer.BadParameter("give either CASE or --index DIR")
    if index is not None and (out is not None or not wait):
        raise typer.BadParameter("the index is written into DIR itself: omit --out and --no-wait")
    if index is not None:
        page = _index(index, templates, progress, as_json=json)
    else:
        result = inspect.unwrap(report)(case, out=out, templates=templates, wait=wait, progress=progress)
        emit(result, as_json=json)
        page = result.path("page")
    if open_page:
        typer.launch(str(page.resolve()))


def _index(folder: Path, templates: Path | None, progress: Progress, *, as_json: bool) -> Path:
    from limbcli.stages.report_pages.index import report_index

    result = report_index(folder, templates=templates, progress=progress)
    if as_json:
        emit_json(result.to_json())
    else:
        say(f"index: {result.page} ({result.n_subjects} subject{'s' if result.n_subjects != 1 else ''})")
    return result.page
