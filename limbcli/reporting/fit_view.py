"""Results of `fit` in the form that the page needs; the only module that knows the keys of fit.json."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limbcli.numbers.interval_limits import Flag
from limbcli.reporting.agreement_view import UNTESTED, AgreementView, agreement_view
from limbcli.reporting.figures.convergence import FitWalk
from limbcli.reporting.headline import Headline, headline
from limbcli.reporting.numbers import DASH, number
from limbcli.results import StageResult

MOONEY_RIVLIN, OGDEN = "mooney-rivlin", "ogden"
LINEAR = "tet4"  # the element that locks
STEP_NAMES = {MOONEY_RIVLIN: "Mooney-Rivlin type", OGDEN: "Ogden type"}


@dataclass(frozen=True, kw_only=True)
class EstimateView:
    """One parameter of one step: value, 95 % interval and verdict."""

    name: str
    value: float | None
    flag: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    interval_why: str = ""
    words: str = ""
    bound: str = ""
    computed: bool = True

    @property
    def is_sound(self) -> bool:
        return self.flag in (Flag.IDENTIFIED, Flag.FIXED)

    @property
    def headline(self) -> Headline:
        """The value, or words if the data do not determine one."""
        return headline(
            self.value, self.low, self.high, self.flag,
            unit=self.unit, bound=self.bound, computed=self.computed,
        )  # fmt: skip

    def times(self, factor: float | None, name: str, unit: str) -> EstimateView | None:
        """Estimate of the parameter times a quantity that is held fixed (kappa' = f_kappa c)."""
        if factor is None:
            return None
        value, low, high = (
            None if each is None else factor * each for each in (self.value, self.low, self.high)
        )
        return replace(self, name=name, value=value, unit=unit, low=low, high=high)


@dataclass(frozen=True, kw_only=True)
class StepView:
    """One identification: the Mooney-Rivlin type (m = 2) or the Ogden type."""

    key: str
    label: str
    c_kpa: float | None
    m: float | None
    kappa_kpa: float | None
    r2: float | None
    rmse_n: float | None
    n_iterations: int | None
    n_solves: int | None
    seconds: float | None
    reason: str
    estimates: tuple[EstimateView, ...]

    def estimate(self, name: str) -> EstimateView | None:
        """Estimate of a free parameter of the step."""
        return next((each for each in self.estimates if each.name == name), None)

    @property
    def kappa(self) -> EstimateView | None:
        """Estimate of kappa' in kPa, derived from f_kappa."""
        f_kappa = self.estimate("f_κ")
        return f_kappa.times(self.c_kpa, "κ′", "kPa") if f_kappa else None


@dataclass(frozen=True, eq=False, kw_only=True)
class FitView:
    element: str
    solver: str
    c_source: str
    c_is_given: bool
    noise_scale: float | None
    noise_source: str
    steps: tuple[StepView, ...]
    walks: tuple[FitWalk, ...]
    raw: Mapping[str, Any]
    force: AgreementView = UNTESTED
    speeds: AgreementView | None = None
    whole: AgreementView = UNTESTED

    def step(self, key: str) -> StepView | None:
        return next((each for each in self.steps if each.key == key), None)

    @property
    def last(self) -> StepView | None:
        return self.step(OGDEN) or (self.steps[-1] if self.steps else None)


def read_fit_view(result: StageResult) -> FitView:
    """The fit of one site, from its result."""
    data = result.data
    element, steps = str(data.get("element", DASH)), data.get("steps", {})
    solver = " ".join(str(data[key]) for key in ("solver", "solver_version") if data.get(key))
    walks = (_walk(key, content) for key, content in steps.items())
    return FitView(
        element=element,
        solver=solver or DASH,
        c_source=str(data.get("c_source") or "").replace("2 mu ", "2 µ "),
        c_is_given=number((data.get("asked") or {}).get("c_kpa")) is not None,
        noise_scale=number(data.get("noise_scale")),
        noise_source=str((data.get("noise") or {}).get("source", "")),
        steps=tuple(_step(key, content, element) for key, content in steps.items()),
        walks=tuple(each for each in walks if each is not None),
        raw=data,
        force=agreement_view(data, "force"),
        speeds=agreement_view(data, "speeds") if "speeds" in (data.get("agreement") or {}) else None,
        whole=agreement_view(data),
    )


_UNITS = {"f_kappa": ("f_κ", ""), "m": ("m", ""), "c_kpa": ("c", "kPa"), "kappa_kpa": ("κ′", "kPa")}


def _step(key: str, content: Mapping[str, Any], element: str) -> StepView:
    names = ("c_kpa", "m", "kappa_kpa", "r2", "rmse_n", "seconds")
    return StepView(
        key=key,
        label=STEP_NAMES.get(key, key),
        reason=str(content.get("reason") or ""),
        estimates=read_estimates(content.get("parameters", {}), element, computed=content.get("interval_95")),
        n_iterations=_count(content.get("n_iterations")),
        n_solves=_count(content.get("n_solves")),
        **{name: number(content.get(name)) for name in names},
    )


def read_estimates(
    parameters: Mapping[str, Any], element: object, *, computed: Collection[str] | None = None
) -> tuple[EstimateView, ...]:
    """The table `parameters` of a fit.

    element : of the fitted models, as in the result
    computed : names of the parameters with an interval; None: all
    """
    locks = LINEAR in str(element)
    return tuple(
        _estimate(name, each, locks=locks, computed=computed is None or name in computed)
        for name, each in parameters.items()
    )


OF_THE_MESH = "of this tet4 mesh, not of the tissue"


def _estimate(name: str, content: Mapping[str, Any], *, locks: bool, computed: bool) -> EstimateView:
    """`locks`: with four-node tetrahedra even a narrow interval of f_kappa describes the mesh, not the
    tissue."""
    symbol, unit = _UNITS.get(name, (name, ""))
    flag = str(content.get("flag") or DASH)
    if locks and name == "f_kappa" and flag == Flag.IDENTIFIED:
        flag = OF_THE_MESH
    return EstimateView(
        name=symbol,
        unit=unit,
        interval_why=str(content.get("interval_reason", "")),
        flag=flag,
        words=str(content.get("words") or ""),
        bound=str(content.get("bound") or ""),
        computed=computed,
        **{key: number(content.get(key)) for key in ("value", "low", "high")},
    )


def _walk(key: str, content: Mapping[str, Any]) -> FitWalk | None:
    history = content.get("history") or []
    if not history:
        return None
    names = [name for name in history[0] if name != "cost_n2"]
    return FitWalk(
        key,
        STEP_NAMES.get(key, key),
        np.array([each["cost_n2"] for each in history]),
        {name: np.array([each[name] for each in history]) for name in names},
    )


def _count(value: object) -> int | None:
    known = number(value)
    return None if known is None else int(known)
