"""fit, fit_joint, fit_states, compare_elements: the parameters, and how reliable each of them is."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from limbcli.api.base import SiteResults, by_site
from limbcli.api.call import CaseLike, Heard, PathLike, at_work, maybe_path, names_of, records_call
from limbcli.api.fit_results import ElementComparison, FitResult, JointFitResult, StatesFitResult
from limbcli.api.limits import one_of, within
from limbcli.api.simulation import SOLVERS, SolverName

if TYPE_CHECKING:
    from limbcli.stages.fitting.options import FitOptions


@records_call
def fit(
    case: CaseLike,
    *,
    out: PathLike | None = None,
    sites: str | Iterable[str] | None = None,
    solver: SolverName = "auto",
    febio: PathLike | None = None,
    c_kpa: float | None = None,
    c_deviation_fraction: float | None = None,
    stiffness_map: bool = False,
    tolerance: float = 1e-3,
    max_iterations: int = 50,
    intervals: bool = True,
    gain_deviation_fraction: float | None = None,
    contact_check: bool = True,
    boundary_check: bool = True,
    cycle: int | str = "last",
    templates: PathLike | None = None,
    time_limit_s: float | None = None,
    wait: bool = True,
    progress: Heard = None,
) -> SiteResults[FitResult]:
    """Identify f_kappa and m of each site from its force-depth curve, with c from SWE. Requires `build_feb`.

    Parameters
    ----------
    case, out, wait, progress : as for `segment`
    sites, solver, febio : as for `run`
    c_kpa : c = 2 mu given directly (None: from the shear-wave speed at level 0)
    c_deviation_fraction : relative standard deviation of c_kpa (None: that of the shear-wave reading)
    stiffness_map : c element by element, from the shear-wave map of level 0
    tolerance : of cost and parameters, relative
    max_iterations : of each step
    intervals : 95 % intervals by profile likelihood, which need more simulations
    gain_deviation_fraction : numerical error of the force to allow for; None: from `mesh(study=True)` if that
        was run, else by element type and edge length
    contact_check : solve the fitted model once more with a stiffer contact
    boundary_check : and with the cut plane free, and with the far side of the limb held; the intervals
        allow for both
    cycle : the loading cycle to fit, if there are several: its number, or "last"
    templates : a folder of Jinja templates that take precedence over the built-in ones
    time_limit_s : of each FEBio run

    Raises
    ------
    CaseError
        If `build_feb` has not been run since its inputs changed, or an argument is invalid.
    MeasurementError
        If the levels cannot be used, or c is neither measured nor given.
    SolveError, FitError
        If the model cannot be solved at the start values, or the search does not converge.

    Source: Levenberg-Marquardt, Nocedal and Wright, Numerical Optimization, 2nd ed., chapter 10; profile
    likelihood, Venzon and Moolgavkar 1988, doi:10.2307/2347496.
    """
    one_of("fit", SOLVERS, solver=solver)
    from limbcli.stages import fit as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = _options(
            c_kpa, c_deviation_fraction, tolerance=tolerance, max_iterations=max_iterations,
            contact_check=contact_check, boundary_check=boundary_check,
            time_limit_s=time_limit_s, cycle=cycle, stiffness_map=stiffness_map,
            intervals=intervals, gain_deviation=gain_deviation_fraction,
            templates=maybe_path(templates, "templates"),
        )  # fmt: skip
        found = stage.fit(
            work.case, out=work.out, sites=names_of(sites), solver=solver, febio=maybe_path(febio, "febio"),
            options=options, progress=work.progress,
        )  # fmt: skip
    return by_site(FitResult, found)


@records_call
def fit_joint(
    case: CaseLike,
    *,
    out: PathLike | None = None,
    sites: str | Iterable[str] | None = None,
    law: str = "ogden",
    compare_laws: bool = False,
    c_kpa: float | None = None,
    c_deviation_fraction: float | None = None,
    gain_deviation_fraction: float | None = None,
    contact_check: bool = True,
    boundary_check: bool = True,
    cycle: int | str = "last",
    wait: bool = True,
    progress: Heard = None,
) -> JointFitResult:
    """Identify one set of parameters for several sites by depth and wave speed.

    The command is `limbcli fit --objective joint`.

    Parameters
    ----------
    case, out, wait, progress : as for `segment`
    sites : those that share the tissue; None: all
    law : "ogden", "mooney-rivlin", "neo-hooke", "two-term-ogden", "holmes-mow" or "fibres"
    compare_laws : fit each law, and compare them by the error of held-out levels
    c_kpa, c_deviation_fraction : c is a free parameter; a given value is its initial guess and, if a site has
        no speeds, the mean of a prior with that standard deviation
    the others : as for `fit`

    Raises
    ------
    CaseError, MeasurementError, SolveError, FitError
        As `fit`.
    """
    from limbcli.stages import fit_joint as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = _options(
            c_kpa, c_deviation_fraction, contact_check=contact_check, boundary_check=boundary_check,
            cycle=cycle,
        )  # fmt: skip
        within("fit", gain_deviation_fraction=gain_deviation_fraction)
        joint = stage.JointOptions(law=law, compare_laws=compare_laws, gain_deviation=gain_deviation_fraction)
        found = stage.fit_joint(
            work.case, out=work.out, sites=names_of(sites), joint=joint, options=options,
            progress=work.progress,
        )  # fmt: skip
    return JointFitResult.of(found)


@records_call
def fit_states(
    case: CaseLike,
    *,
    out: PathLike | None = None,
    sites: str | Iterable[str] | None = None,
    law: str = "ogden",
    gain_deviation_fraction: float | None = None,
    wait: bool = True,
    progress: Heard = None,
) -> SiteResults[StatesFitResult]:
    """Identify one law, and the stretch of each state, for each site with states.

    The command is `limbcli fit --objective states`.

    Parameters
    ----------
    case, out, wait, progress : as for `segment`
    sites : sites without states are skipped; None: all
    law : as for `fit_joint`
    gain_deviation_fraction : as for `fit`

    Raises
    ------
    CaseError
        If no site has states, they do not differ, or `build_feb` has not been run since its inputs changed.
    MeasurementError
        If the levels of a state cannot be used, or have no speed at rest.
    SolveError, FitError
        As `fit`.
    """
    from limbcli.stages import fit_states as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        within("fit", gain_deviation_fraction=gain_deviation_fraction)
        states = stage.StatesOptions(law=law, gain_deviation=gain_deviation_fraction)
        found = stage.fit_states(
            work.case, out=work.out, sites=names_of(sites), states=states, progress=work.progress
        )
    return by_site(StatesFitResult, found)


@records_call
def compare_elements(
    case: CaseLike,
    *,
    out: PathLike | None = None,
    sites: str | Iterable[str] | None = None,
    c_kpa: float | None = None,
    tolerance: float = 1e-3,
    max_iterations: int = 50,
    cycle: int | str = "last",
    wait: bool = True,
    progress: Heard = None,
) -> SiteResults[ElementComparison]:
    """Fit each site with tet4 and with tet10 on the same mesh (`limbcli fit --compare-element`).

    Parameters
    ----------
    case, out, wait, progress : as for `segment`
    the others : as for `fit`

    Raises
    ------
    CaseError, MeasurementError, MeshError, SolveError, FitError
        As `fit`; MeshError if the mesh does not consist of tetrahedra.
    """
    from limbcli.stages import fit_elements as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = _options(
            c_kpa, None, tolerance=tolerance, max_iterations=max_iterations, contact_check=False,
            boundary_check=False, cycle=cycle,
        )  # fmt: skip
        found = stage.compare_elements(
            work.case, out=work.out, sites=names_of(sites), options=options, progress=work.progress
        )
    return by_site(ElementComparison, found)


def _options(
    c_kpa: float | None,
    c_deviation_fraction: float | None,
    *,
    contact_check: bool,
    boundary_check: bool,
    cycle: int | str,
    tolerance: float = 1e-3,
    max_iterations: int = 50,
    time_limit_s: float | None = None,
    **others: Any,
) -> FitOptions:
    """The options of the stage, which itself checks the ranges of numbers."""
    within(
        "fit", c_kpa=c_kpa, c_deviation_fraction=c_deviation_fraction, tolerance=tolerance,
        max_iterations=max_iterations, time_limit_s=time_limit_s,
        gain_deviation_fraction=others.get("gain_deviation"),
    )  # fmt: skip
    from limbcli.stages.fitting.options import FitOptions, check_numbers

    options = FitOptions(
        c_kpa=c_kpa, c_deviation=c_deviation_fraction, tolerance=tolerance, max_iterations=max_iterations,
        contact_check=contact_check, boundary_check=boundary_check, time_limit_s=time_limit_s,
        cycle=str(cycle), **others,
    )  # fmt: skip
    check_numbers(options)
    return options
