"""Results of fits: estimates with intervals, flags and explanations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from limbcli.api.stage_result import Result
from limbcli.api.tables import Table, read_columns
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.model import LimbModel


@dataclass(frozen=True)
class Estimate:
    """Estimate of one parameter, as far as the data determine it.

    Attributes
    ----------
    parameter : its name, with its unit if it has one ("c_kpa", "f_kappa", "m")
    value : the estimate; check `flag` before quoting it
    standard_error : None if there is none
    low_95, high_95 : ends of the 95 % interval; None: open on that side, or not requested (see `words`)
    flag : "identified", "fixed", or why not: "weak", "trades off with ...", "at bound", "no influence"
    words : the same as a sentence that can be quoted
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
            parameter=name, value=each["value"], standard_error=each.get("standard_error"),
            low_95=each.get("low"), high_95=each.get("high"), flag=each["flag"], words=each["words"],
        )
        for name, each in tables.items()
    )  # fmt: skip


def _of_all(found: StageResult) -> tuple[Estimate, ...]:
    return _estimates(found.data["parameters"])


class _WithParameters(Result):
    """Results that hold estimates: one row per parameter."""

    parameters: tuple[Estimate, ...]

    def parameter(self, name: str) -> Estimate:
        """The estimate of that name; otherwise a KeyError lists the available names."""
        known = {each.parameter: each for each in self.parameters}
        if name not in known:
            raise KeyError(f"{name!r}; the parameters are {', '.join(known)}")
        return known[name]

    def rows(self) -> list[dict[str, Any]]:
        return [self._named(asdict(each)) for each in self.parameters]


@dataclass(frozen=True, eq=False)
class FitResult(_WithParameters):
    """The identified parameters of a site. `table()` has one row per parameter.

    A number whose `Estimate.flag` is neither "identified" nor "fixed" is not a finding: quote its words
    instead.

    Attributes
    ----------
    c_kpa, f_kappa, kappa_kpa, m : the law's parameters, kappa' = f_kappa c
    parameters : the same with intervals, flags and words
    r2, rmse_n : goodness of fit of the simulated force
    solver, element : used for the simulations
    n_solves : number of simulations of the identification
    n_interval_solves : number of simulations of the intervals
    """

    stage: ClassVar[str] = "fit"
    c_kpa: float
    f_kappa: float
    kappa_kpa: float
    m: float
    parameters: tuple[Estimate, ...] = field(
        metadata={"from": lambda found: _estimates(found.data["steps"]["ogden"]["parameters"])}
    )
    r2: float
    rmse_n: float
    solver: str
    element: str
    n_solves: int
    n_interval_solves: int

    def curves(self) -> Table:
        """Forces over depth_mm (n_depths,): measured_n (NaN between levels), start_n, and one column per
        step."""
        return read_columns(self.files["curves"])

    def model(self) -> LimbModel:
        """The fitted model, as in fitted.feb."""
        from limbcli.feb.read import read_feb

        return read_feb(self.files["feb"])


@dataclass(frozen=True, eq=False)
class JointFitResult(_WithParameters):
    """One set of parameters for several sites. `table()` has one row per parameter.

    Attributes
    ----------
    law : its name
    sites : the sites whose measurements were used
    parameters : with intervals, flags and words
    chi_square, n_freedom : of the joint likelihood
    laws : with `compare_laws` one row per law, ordered by the error of held-out levels, best first
    """

    stage: ClassVar[str] = "fit-joint"
    law: str
    sites: tuple[str, ...]
    parameters: tuple[Estimate, ...] = field(metadata={"from": _of_all})
    chi_square: float
    n_freedom: int
    laws: tuple[dict[str, Any], ...] = field(
        metadata={"from": lambda found: tuple(found.data.get("laws", ()))}
    )


@dataclass(frozen=True, eq=False)
class StatesFitResult(_WithParameters):
    """One law for several states of a site, and the stretch of each state. `table()` has one row per
    parameter.

    Attributes
    ----------
    law : its name
    parameters : those of the law and of the stretches, with intervals, flags and words
    states : by name: `stretch_along` and `stretch_around` relative to the unloaded tissue (`told`: as stated
        in the case; `value`, `low`, `high`, `known`), and the measured and fitted speed at rest
        (`swe_at_rest_m_per_s`, `..._fitted_m_per_s`)
    least_stiffness : by direction ("along", "around"): `stretch`, `low`, `high` (None: open), `told` (whether
        the data determine it), `words`
    undetermined : one sentence for each quantity that the data do not determine
    chi_square, n_freedom : of the likelihood
    """

    stage: ClassVar[str] = "fit-states"
    law: str
    parameters: tuple[Estimate, ...] = field(metadata={"from": _of_all})
    states: dict[str, dict[str, Any]]
    least_stiffness: dict[str, dict[str, Any]]
    undetermined: tuple[str, ...]
    chi_square: float
    n_freedom: int

    def model(self, state: str) -> LimbModel:
        """The fitted model of a state, prestretched, as in <state>.feb."""
        from limbcli.feb.read import read_feb

        return read_feb(self.files[f"feb_{state}"])


@dataclass(frozen=True, eq=False)
class ElementComparison(Result):
    """The same site fitted with tet4 and tet10 on the same mesh. `table()` has one row per element type.

    Attributes
    ----------
    c_kpa : held fixed
    force_ratio_tet4_over_tet10 : at f_kappa 100 and m 2, at the last level: a measure of the locking of tet4
    """

    stage: ClassVar[str] = "fit-elements"
    c_kpa: float
    force_ratio_tet4_over_tet10: float

    def rows(self) -> list[dict[str, Any]]:
        several = self.data["elements"].values()
        return [
            self._named({name: value for name, value in each.items() if not isinstance(value, list)})
            for each in several
        ]
