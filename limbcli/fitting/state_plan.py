"""Which of the states' stretches are known, which are searched for, and each state's elastic stretch.

Stretches given in a case are relative to a length chosen by the user. In each direction (way: along, around)
the tissue is unloaded at one such stretch: the case gives it; or it is that of all states, if all give the
same; otherwise it is searched for. A state's elastic stretch is its given stretch divided by the unloaded
one. For stretches that are not given, the elastic stretch itself is searched for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.case import Site
from limbcli.errors import CaseError
from limbcli.inference.joint_fit import States
from limbcli.inference.parameter import FitParameter
from limbcli.model import Array
from limbcli.site_model.prestretch import WAYS

LOW, HIGH = 0.6, 1.6  # range of elastic stretches that is searched
_STEP_FACTOR = 1.2
_REACH = 0.1  # least half-range, in ln stretch, of the first simulations


@dataclass(frozen=True, eq=False)
class StretchPlan(States):
    """The known and the searched stretches of a site's states.

    ways : directions in which any state is stretched; the `parameters` are those searched for
    unloaded : by way, the given stretch at which the tissue is unloaded, if that is not searched for
    taken : ways in which it was assumed to be the stretch of all states, because all give the same
    """

    ways: tuple[str, ...]
    unloaded: dict[str, float]
    taken: tuple[str, ...]

    def stretches(self, k: int, values: Array) -> Array:
        """Elastic stretches (n_ways,) of state k."""
        return np.exp(self.offsets[k] + self.factors[k] @ np.log(values))

    def is_known(self, k: int, way: str) -> bool:
        """Whether the state's stretch in this direction does not depend on searched parameters."""
        return way not in self.ways or not self.factors[k, self.ways.index(way)].any()

    def elastic(self, k: int, way: str, values: Array) -> float:
        """One elastic stretch of state k; 1 in a direction in which no state is stretched."""
        return float(self.stretches(k, values)[self.ways.index(way)]) if way in self.ways else 1.0

    def first_places(self) -> tuple[Array, list[Array]]:
        """Elastic stretches (n_ways,) of the first simulations: the states' middle and points around it."""
        values = np.array([each.start for each in self.parameters])
        logs = np.log([self.stretches(k, values) for k in range(len(self.offsets))])
        low, high = np.minimum(logs.min(axis=0), -_REACH), np.maximum(logs.max(axis=0), _REACH)
        middle, places = 0.5 * (low + high), []
        for j in range(len(self.ways)):
            for end in (low, high):
                place = middle.copy()
                place[j] = end[j]
                places.append(np.exp(place))
        return np.exp(middle), places


def stretch_plan(site: Site) -> StretchPlan:
    """The plan of a site's states. Raises the errors of `plan_of`."""
    given = {way: [getattr(each.stretch, way) for each in site.states] for way in WAYS}
    unloaded = {way: getattr(site.unloaded, way) for way in WAYS}
    return plan_of(given, unloaded, [each.name for each in site.states], where=f"site {site.name}")


def plan_of(
    given: Mapping[str, Sequence[float | None]], known_unloaded: Mapping[str, float | None],
    states: Sequence[str], *, where: str = "the case",
) -> StretchPlan:  # fmt: skip
    """The plan for these given stretches: by way, that of every state, None if unknown; ways left out are not
    stretched. known_unloaded : by way, the given stretch at which the tissue is known to be unloaded

    Raises CaseError if the states do not differ, or give stretches too far apart to be searched.
    """
    ways: list[str] = []
    columns: list[Array] = []
    parameters: list[FitParameter] = []
    entries: list[tuple[int, int, int, float]] = []  # state, way, parameter, exponent of the parameter
    unloaded: dict[str, float] = {}
    taken: list[str] = []
    for way, stretches in given.items():
        known = [each for each in stretches if each is not None]
        zero = known_unloaded.get(way)
        if zero is None and len(known) == len(stretches) and len(set(known)) == 1:
            zero = known[0]
            taken.append(way)
        if zero is not None:
            unloaded[way] = zero
            if all(each == zero for each in stretches):
                continue
        middle = zero or (float(np.sqrt(max(known) * min(known))) if known else 1.0)
        _check_range(where, [each / middle for each in known], way)
        searched, of_states = _searched(states, way, stretches, zero, middle)
        count = zero or 1.0
        columns.append(np.array([0.0 if each is None else np.log(each / count) for each in stretches]))
        entries += [(k, len(ways), len(parameters) + j, factor) for k, j, factor in of_states]
        parameters += searched
        ways.append(way)
    if not ways:
        raise CaseError(
            f"the states of {where} do not differ in their stretch",
            where="case.toml, [[site.state]]",
            fix="give what was stretched (stretch_along, stretch_around), or omit it where unknown",
        )
    factors = np.zeros((len(states), len(ways), len(parameters)))
    for k, w, j, factor in entries:
        factors[k, w, j] = factor
    offsets = np.array(columns).T
    return StretchPlan(tuple(parameters), offsets, factors, tuple(ways), unloaded, tuple(taken))


def _searched(
    states: Sequence[str], way: str, given: Sequence[float | None], zero: float | None, middle: float
) -> tuple[list[FitParameter], list[tuple[int, int, float]]]:
    """Parameters searched for in one way, and (state, index of parameter, its exponent in the stretch)."""
    parameters, entries = [], []
    known = [each for each in given if each is not None]
    if zero is None and known:
        low, high = max(known) / HIGH, min(known) / LOW
        name = f"unloaded_stretch_{way}"
        parameters.append(FitParameter(name, middle, low, high, "log", step_factor=_STEP_FACTOR))
        entries += [(k, 0, -1.0) for k, each in enumerate(given) if each is not None]
    for k, each in enumerate(given):
        if each is None:
            entries.append((k, len(parameters), 1.0))
            name = f"stretch_{way}_{states[k]}"
            parameters.append(FitParameter(name, 1.0, LOW, HIGH, "log", step_factor=_STEP_FACTOR))
    return parameters, entries


def _check_range(where: str, stretches: Sequence[float], way: str) -> None:
    wrong = [each for each in stretches if not LOW < each < HIGH]
    if wrong:
        raise CaseError(
            f"{where}: a state's stretch {way} the limb is {wrong[0]:.3g} of the unloaded tissue; "
            f"possible values are {LOW:g} to {HIGH:g}",
            where="case.toml, [[site.state]]",
            fix=f"correct stretch_{way}, or unloaded_stretch_{way}",
        )
