"""fit, fit_joint, fit_states, compare_elements: the parameters, and how reliable each of them is."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, get_args

from limbcli.api.call import CaseLike, Heard, PathLike, at_work, maybe_path
from limbcli.api.fit_results import ElementComparison, FitResult, JointFitResult, StatesFitResult
from limbcli.api.stage_result import each_site, one
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
    LawName,
    Option,
    SolverName,
)  # fmt: skip
from limbcli.results import StageResult

C_DEVIATION = Option("Relative standard deviation of c; default: from the noise of the wave speed.")
TOLERANCE = Option("Relative tolerance of cost and parameters, at which the search ends.")
MAX_ITERATIONS = Option("Largest number of iterations in each step of the fit.", (1, None))
GAIN_DEVIATION = Option(
    "Relative standard deviation of the force due to the mesh; default: from the mesh study, else from the "
    "element's type and size."
)
CONTACT_CHECK = Option(
    "Also solve the fitted model with a stiffer contact, to see how much force the probe's penetration costs."
)
BOUNDARY_CHECK = Option(
    "Also solve the fitted model with the cut plane free, and with the limb's far side held; the intervals "
    "allow for both."
)
CYCLE = Option("Loading cycle to fit, if there are several: a number, or last.", kind=str, such_as=("last",))
LAW = Option(f"Law for joint and states: {' | '.join(get_args(LawName))}.", before="gain_deviation_fraction")
COMPARE_LAWS = Option(
    "Joint only: compare all laws by the error of held-out levels.", before="gain_deviation_fraction"
)


@each_site(FitResult)
def fit(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    solver: Annotated[SolverName, SOLVER] = "auto",
    febio: Annotated[PathLike | None, FEBIO] = None,
    c_kpa: Annotated[float | None, C_KPA] = None,
    c_deviation_fraction: Annotated[float | None, C_DEVIATION] = None,
    stiffness_map: Annotated[
        bool, Option("Give each element its own c, from the shear-wave map of level 0.")
    ] = False,
    tolerance: Annotated[float, TOLERANCE] = 1e-3,
    max_iterations: Annotated[int, MAX_ITERATIONS] = 50,
    intervals: Annotated[bool, Option("95 % intervals by profile likelihood.")] = True,
    time_limit_s: Annotated[float | None, Option("Time limit of each FEBio run.")] = None,
    gain_deviation_fraction: Annotated[float | None, GAIN_DEVIATION] = None,
    contact_check: Annotated[bool, CONTACT_CHECK] = True,
    boundary_check: Annotated[bool, BOUNDARY_CHECK] = True,
    cycle: Annotated[int | str, CYCLE] = "last",
    templates: Annotated[PathLike | None, TEMPLATES] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> Iterable[StageResult]:
    """Identify f_kappa and m of each site from its force-depth curve, with c from SWE. Requires `build_feb`.

    Raises
    ------
    CaseError
        If `build_feb` has not been run since its inputs changed, or an argument is invalid.
    MeasurementError
        If the levels cannot be used, or c is neither measured nor given.
    SolveError, FitError
        If the model cannot be solved at the start values, or the search does not converge.

    Source: bounded least squares, Voglis and Lagaris 2004 (scipy's "dogbox"); profile
    likelihood, Venzon and Moolgavkar 1988, doi:10.2307/2347496.
    """
    from limbcli.stages import fit as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = stage.FitOptions(
            c_kpa=c_kpa, c_deviation=c_deviation_fraction, stiffness_map=stiffness_map, tolerance=tolerance,
            max_iterations=max_iterations, intervals=intervals, gain_deviation=gain_deviation_fraction,
            contact_check=contact_check, boundary_check=boundary_check, cycle=str(cycle),
            templates=maybe_path(templates, "templates"), time_limit_s=time_limit_s,
        )  # fmt: skip
        return work.run(stage.fit, sites=sites, solver=solver, febio=febio, options=options)


@one(JointFitResult)
def fit_joint(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    law: Annotated[LawName, LAW] = "ogden",
    compare_laws: Annotated[bool, COMPARE_LAWS] = False,
    c_kpa: Annotated[float | None, C_KPA] = None,
    c_deviation_fraction: Annotated[float | None, C_DEVIATION] = None,
    gain_deviation_fraction: Annotated[float | None, GAIN_DEVIATION] = None,
    contact_check: Annotated[bool, CONTACT_CHECK] = True,
    boundary_check: Annotated[bool, BOUNDARY_CHECK] = True,
    cycle: Annotated[int | str, CYCLE] = "last",
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> StageResult:
    """Identify one set of parameters for several sites by depth and wave speed.

    The command is `limbcli fit --objective joint`. c is a free parameter; a given value is its initial guess
    and, if a site has no speeds, the mean of a prior with the given standard deviation.

    Raises
    ------
    CaseError, MeasurementError, SolveError, FitError
        As `fit`.
    """
    from limbcli.fitting.options import FitOptions
    from limbcli.stages import fit_joint as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = FitOptions(
            c_kpa=c_kpa, c_deviation=c_deviation_fraction, contact_check=contact_check,
            boundary_check=boundary_check, cycle=str(cycle), law=law, compare_laws=compare_laws,
            gain_deviation=gain_deviation_fraction,
        )  # fmt: skip
        return work.run(stage.fit_joint, sites=sites, options=options)


@each_site(StatesFitResult)
def fit_states(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    law: Annotated[LawName, LAW] = "ogden",
    gain_deviation_fraction: Annotated[float | None, GAIN_DEVIATION] = None,
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> Iterable[StageResult]:
    """Identify one law, and the stretch of each state, for each site with states.

    Sites without states are skipped. The command is `limbcli fit --objective states`.

    Raises
    ------
    CaseError
        If no site has states, they do not differ, or `build_feb` has not been run since its inputs changed.
    MeasurementError
        If the levels of a state cannot be used, or have no speed at rest.
    SolveError, FitError
        As `fit`.
    """
    from limbcli.fitting.options import FitOptions
    from limbcli.stages import fit_states as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = FitOptions(law=law, gain_deviation=gain_deviation_fraction)
        return work.run(stage.fit_states, sites=sites, options=options)


@each_site(ElementComparison)
def compare_elements(
    case: Annotated[CaseLike, CASE],
    *,
    out: Annotated[PathLike | None, OUT] = None,
    sites: Annotated[str | Iterable[str] | None, SITES] = None,
    c_kpa: Annotated[float | None, C_KPA] = None,
    tolerance: Annotated[float, TOLERANCE] = 1e-3,
    max_iterations: Annotated[int, MAX_ITERATIONS] = 50,
    cycle: Annotated[int | str, CYCLE] = "last",
    wait: Annotated[bool, WAIT] = True,
    progress: Annotated[Heard, PROGRESS] = None,
) -> Iterable[StageResult]:
    """Fit each site with tet4 and with tet10 on the same mesh (`limbcli fit --compare-element`).

    Raises
    ------
    CaseError, MeasurementError, MeshError, SolveError, FitError
        As `fit`; MeshError if the mesh does not consist of tetrahedra.
    """
    from limbcli.fitting.options import FitOptions
    from limbcli.stages import fit_elements as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = FitOptions(
            c_kpa=c_kpa, tolerance=tolerance, max_iterations=max_iterations, contact_check=False,
            boundary_check=False, cycle=str(cycle),
        )  # fmt: skip
        return work.run(stage.compare_elements, sites=sites, options=options)
