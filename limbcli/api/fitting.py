"""fit, fit_joint and compare_elements: the tissue's parameters, and how far each can be trusted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from limbcli.api.base import Result, SiteResults, by_site
from limbcli.api.call import CaseLike, Heard, PathLike, at_work, maybe_path, names_of
from limbcli.api.limits import one_of, within
from limbcli.api.simulation import SOLVERS, SolverName
from limbcli.api.tables import Table, read_columns
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.model import LimbModel
    from limbcli.stages.fit_options import FitOptions


@dataclass(frozen=True)
class Estimate:
    """One parameter, as far as the data tell it.

    Attributes
    ----------
    parameter : its name, with its unit where it has one ("c_kpa", "f_kappa", "m")
    value : the estimate; read `flag` before it is quoted
    standard_error : None where there is none
    low_95, high_95 : ends of the 95 % interval; None: open to that side
    flag : "identified", "fixed", or why not: "weak", "trades off with ...", "at bound", "no influence"
    words : the same as a sentence that may be quoted
    """

    parameter: str
    value: float
    standard_error: float | None
    low_95: float | None
    high_95: float | None
    flag: str
    words: str


def _estimates(tables: Mapping[str, Mapping[str, Any]]) -> tuple[Estimate, ...]:
    return tuple(
        Estimate(
            name, each["value"], each.get("standard_error"), each.get("low"), each.get("high"),
            each["flag"], each["words"],
        )
        for name, each in tables.items()
    )  # fmt: skip


class _WithParameters(Result):
    """Results that hold estimates: a row a parameter."""

    parameters: tuple[Estimate, ...]

    def parameter(self, name: str) -> Estimate:
        """One estimate by its name; a KeyError names those there are."""
        known = {each.parameter: each for each in self.parameters}
        if name not in known:
            raise KeyError(f"{name!r}; the parameters are {', '.join(known)}")
        return known[name]

    def rows(self) -> list[dict[str, Any]]:
        return [self._named(asdict(each)) for each in self.parameters]


@dataclass(frozen=True, eq=False)
class FitResult(_WithParameters):
    """The identified parameters of a site. `table()` has a row a parameter.

    A number whose `Estimate.flag` is neither "identified" nor "fixed" is no finding: quote its words.

    Attributes
    ----------
    c_kpa, f_kappa, kappa_kpa, m : the law's parameters, kappa' = f_kappa c
    parameters : the same with intervals, flags and words
    r2, rmse_n : how well the simulated force meets the measured one
    solver, element : what it was simulated with
    n_solves : simulations of the identification, n_interval_solves : of the intervals
    """

    stage: ClassVar[str] = "fit"
    c_kpa: float
    f_kappa: float
    kappa_kpa: float
    m: float
    parameters: tuple[Estimate, ...]
    r2: float
    rmse_n: float
    solver: str
    element: str
    n_solves: int
    n_interval_solves: int

    @classmethod
    def of(cls, found: StageResult) -> Self:
        data = found.data
        return cls(
            found, data["c_kpa"], data["f_kappa"], data["kappa_kpa"], data["m"],
            _estimates(data["steps"]["ogden"]["parameters"]), data["r2"], data["rmse_n"],
            data["solver"], data["element"], data["n_solves"], data["n_interval_solves"],
        )  # fmt: skip

    def curves(self) -> Table:
        """Forces over depth_mm (n_depths,): measured_n (NaN between levels), start_n, and each step's."""
        return read_columns(self.files["curves"])

    def model(self) -> LimbModel:
        """The fitted model, as in fitted.feb."""
        from limbcli.feb.read import read_feb

        return read_feb(self.files["feb"])


@dataclass(frozen=True, eq=False)
class JointFitResult(_WithParameters):
    """One set of parameters for several sites. `table()` has a row a parameter.

    Attributes
    ----------
    law : its name; sites : whose measurements went in
    parameters : with intervals, flags and words
    chi_square, n_freedom : of the joint likelihood
    laws : with `compare_laws` a row a law, best first by the error of levels left out
    """

    stage: ClassVar[str] = "fit-joint"
    law: str
    sites: tuple[str, ...]
    parameters: tuple[Estimate, ...]
    chi_square: float
    n_freedom: int
    laws: tuple[dict[str, Any], ...]

    @classmethod
    def of(cls, found: StageResult) -> Self:
        data = found.data
        return cls(
            found, data["law"], tuple(data["sites"]), _estimates(data["parameters"]), data["chi_square"],
            data["n_freedom"], tuple(data.get("laws", ())),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ElementComparison(Result):
    """The same site fitted with tet4 and tet10 of the same mesh. `table()` has a row an element.

    Attributes
    ----------
    c_kpa : held fixed
    force_ratio_tet4_over_tet10 : at f_kappa 100 and m 2, at the last level: how far tet4 locks
    """

    stage: ClassVar[str] = "fit-elements"
    c_kpa: float
    force_ratio_tet4_over_tet10: float

    @classmethod
    def of(cls, found: StageResult) -> Self:
        return cls(found, found.data["c_kpa"], found.data["force_ratio_tet4_over_tet10"])

    def rows(self) -> list[dict[str, Any]]:
        several = self.data["elements"].values()
        return [
            self._named({name: value for name, value in each.items() if not isinstance(value, list)})
            for each in several
        ]


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
    templates: PathLike | None = None,
    time_limit_s: float | None = None,
    wait: bool = True,
    progress: Heard = None,
) -> SiteResults[FitResult]:
    """Identify f_kappa and m of each site from its force-depth curve, c from SWE. Comes after `build_feb`.

    Parameters
    ----------
    case, out, wait, progress : as of `segment`
    sites, solver, febio : as of `run`
    c_kpa : c = 2 mu by hand (None: from the shear-wave speed at level 0), with its relative standard
        deviation c_deviation_fraction (None: that of the shear-wave reading)
    stiffness_map : c element by element, from the shear-wave map of level 0
    tolerance : of cost and parameters, relative; max_iterations : of each step
    intervals : 95 % intervals by profile likelihood, which cost more simulations
    gain_deviation_fraction : numerical error of the force to allow for; None: from `mesh(study=True)` where
        that was run, else by element and edge length
    contact_check : solve the fitted model once more with a harder contact
    templates : a folder of Jinja templates that come before ours
    time_limit_s : of each FEBio run

    Raises
    ------
    CaseError
        If `build_feb` has not been run since its inputs changed, or an argument cannot be used.
    MeasurementError
        If the levels cannot be used, or c is neither measured nor given.
    SolveError, FitError
        If the model cannot be solved at the start values, or the search does not settle.

    Source: Levenberg-Marquardt, Nocedal and Wright, Numerical Optimization, 2nd ed., chapter 10; profile
    likelihood, Venzon and Moolgavkar 1988, doi:10.2307/2347496.
    """
    one_of("fit", SOLVERS, solver=solver)
    from limbcli.stages import fit as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = _options(
            c_kpa, c_deviation_fraction, tolerance, max_iterations, contact_check, time_limit_s,
            stiffness_map=stiffness_map, intervals=intervals, gain_deviation=gain_deviation_fraction,
            templates=maybe_path(templates, "templates"),
        )  # fmt: skip
        found = stage.fit(
            work.case, out=work.out, sites=names_of(sites), solver=solver, febio=maybe_path(febio, "febio"),
            options=options, progress=work.progress,
        )  # fmt: skip
    return by_site(FitResult, found)


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
    tolerance: float = 1e-3,
    max_iterations: int = 50,
    contact_check: bool = True,
    wait: bool = True,
    progress: Heard = None,
) -> JointFitResult:
    """One set of parameters for several sites, by depth and wave speed (`limbcli fit --objective joint`).

    Parameters
    ----------
    case, out, wait, progress : as of `segment`
    sites : those that share the tissue; None: all
    law : "ogden", "mooney-rivlin", "neo-hooke", "two-term-ogden" or "holmes-mow"
    compare_laws : fit every law, and compare them by the error of levels left out
    the others : as of `fit`

    Raises
    ------
    CaseError, MeasurementError, SolveError, FitError
        As `fit`.
    """
    from limbcli.stages import fit_joint as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = _options(c_kpa, c_deviation_fraction, tolerance, max_iterations, contact_check, None)
        within("fit", gain_deviation_fraction=gain_deviation_fraction)
        joint = stage.JointOptions(law=law, compare_laws=compare_laws, gain_deviation=gain_deviation_fraction)
        found = stage.fit_joint(
            work.case, out=work.out, sites=names_of(sites), joint=joint, options=options,
            progress=work.progress,
        )  # fmt: skip
    return JointFitResult.of(found)


def compare_elements(
    case: CaseLike,
    *,
    out: PathLike | None = None,
    sites: str | Iterable[str] | None = None,
    c_kpa: float | None = None,
    tolerance: float = 1e-3,
    max_iterations: int = 50,
    wait: bool = True,
    progress: Heard = None,
) -> SiteResults[ElementComparison]:
    """Fit each site with tet4 and with tet10 of the same mesh (`limbcli fit --compare-element`).

    Parameters
    ----------
    case, out, wait, progress : as of `segment`
    the others : as of `fit`

    Raises
    ------
    CaseError, MeasurementError, MeshError, SolveError, FitError
        As `fit`; MeshError if the mesh is not of tetrahedra.
    """
    from limbcli.stages import fit_elements as stage

    with at_work(case, out, wait=wait, progress=progress) as work:
        options = _options(c_kpa, None, tolerance, max_iterations, False, None)
        found = stage.compare_elements(
            work.case, out=work.out, sites=names_of(sites), options=options, progress=work.progress
        )
    return by_site(ElementComparison, found)


def _options(
    c_kpa: float | None,
    c_deviation_fraction: float | None,
    tolerance: float,
    max_iterations: int,
    contact_check: bool,
    time_limit_s: float | None,
    **others: Any,
) -> FitOptions:
    """As the stage takes them; the stage itself says which numbers are possible."""
    within(
        "fit", c_kpa=c_kpa, c_deviation_fraction=c_deviation_fraction, tolerance=tolerance,
        max_iterations=max_iterations, time_limit_s=time_limit_s,
        gain_deviation_fraction=others.get("gain_deviation"),
    )  # fmt: skip
    from limbcli.stages.fit_options import FitOptions, check_numbers

    options = FitOptions(
        c_kpa=c_kpa, c_deviation=c_deviation_fraction, tolerance=tolerance, max_iterations=max_iterations,
        contact_check=contact_check, time_limit_s=time_limit_s, **others,
    )  # fmt: skip
    check_numbers(options, gain_deviation=options.gain_deviation)
    return options
