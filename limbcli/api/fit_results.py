"""What fits return: estimates with their intervals, flags and words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from limbcli.api.base import Result
from limbcli.api.tables import Table, read_columns
from limbcli.results import StageResult

if TYPE_CHECKING:
    from limbcli.model import LimbModel


@dataclass(frozen=True)
class Estimate:
    """One parameter, as far as the data determine it.

    Attributes
    ----------
    parameter : its name, with its unit where it has one ("c_kpa", "f_kappa", "m")
    value : the estimate; read `flag` before it is quoted
    standard_error : None where there is none
    low_95, high_95 : ends of the 95 % interval; None: open to that side, or none was asked for (see `words`)
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
class StatesFitResult(_WithParameters):
    """One law for several states of a site, and how far each was stretched. `table()` has a row a parameter.

    Attributes
    ----------
    law : its name
    parameters : the law's and those of the stretches, with intervals, flags and words
    states : by name: `stretch_along` and `stretch_around` over the unloaded tissue (told, value, low, high,
        known), the speed at rest as measured and as fitted (`swe_at_rest_m_per_s`, `..._fitted_m_per_s`)
    least_stiffness : by way ("along", "around"): `stretch`, `low`, `high` (None: open), `told`, `words`
    undetermined : a sentence for everything that the data leave open
    chi_square, n_freedom : of the likelihood
    """

    stage: ClassVar[str] = "fit-states"
    law: str
    parameters: tuple[Estimate, ...]
    states: dict[str, dict[str, Any]]
    least_stiffness: dict[str, dict[str, Any]]
    undetermined: tuple[str, ...]
    chi_square: float
    n_freedom: int

    @classmethod
    def of(cls, found: StageResult) -> Self:
        data = found.data
        return cls(
            found, data["law"], _estimates(data["parameters"]), dict(data["states"]),
            dict(data["least_stiffness"]), tuple(data["undetermined"]), data["chi_square"], data["n_freedom"],
        )  # fmt: skip

    def model(self, state: str) -> LimbModel:
        """The fitted model of a state, prestretched, as in <state>.feb."""
        from limbcli.feb.read import read_feb

        return read_feb(self.files[f"feb_{state}"])


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
