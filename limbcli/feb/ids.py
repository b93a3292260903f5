"""Numbers and formulas as text, and the ids of a model's parts in a file (from 1, without gaps)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from limbcli.errors import CaseError
from limbcli.model import Curve, ElementMap, LimbModel, Material, NodeMap, Step, Value
from limbcli.numbers.math_expressions import Formula

Amount = float | Formula  # of a load

_TIME_DIGITS = 12
_Map = TypeVar("_Map", ElementMap, NodeMap)
_LARGEST_WHOLE = 1e15


def number(value: float) -> str:
    """The shortest text that parses to the same binary value.

    >>> number(2.0), number(0.1 + 0.2), number(1e-9), number(-0.0), number(True)
    ('2', '0.30000000000000004', '1e-09', '-0.0', '1')
    """
    value = float(value)
    if not math.isfinite(value):
        raise CaseError(f"{value} cannot be written", where="model file", fix="give finite values")
    whole = (
        value.is_integer()
        and abs(value) < _LARGEST_WHOLE
        and not (value == 0 and math.copysign(1, value) < 0)
    )
    return str(int(value)) if whole else repr(value)


def vector(values: Iterable[float]) -> str:
    """
    >>> vector((0.0, 0.5, -1.0))
    '0,0.5,-1'
    """
    return ",".join(number(each) for each in values)


def has_formulas(values: Sequence[Amount]) -> bool:
    return any(isinstance(each, Formula) for each in values)


def amounts(values: Sequence[Amount]) -> str:
    """Numbers, or formulas if one of them is one, separated by commas."""
    return ",".join(each.text if isinstance(each, Formula) else number(each) for each in values)


def against(values: Sequence[Amount]) -> list[Amount]:
    """The opposite of each, without negative zeros."""
    return [-each if isinstance(each, Formula) else 0.0 - each for each in values]


@dataclass(frozen=True)
class Ids:
    """Ids of materials (deformable first, then rigid bodies) and load controllers by name."""

    materials: dict[str, int]
    curves: dict[str, int]
    all_curves: dict[str, Curve]
    must_curves: tuple[str | None, ...]


def give_ids(model: LimbModel) -> Ids:
    """Assign ids to all parts; the must-points of each step become a separate load curve."""
    names = [*model.materials, *(body.name for body in model.bodies)]
    contacts = [contact.name for contact in model.contacts]
    for what, several in (
        ("materials and rigid bodies share a name", names),
        ("contacts share a name, by which their surfaces are found", contacts),
    ):
        if len(set(several)) != len(several):
            fix = "name each of them differently"
            raise CaseError(f"{what}: {several}", where="model", fix=fix)
    curves = dict(model.curves)
    must_curves: list[str | None] = []
    start = 0.0
    for step in model.steps:
        must_curves.append(_must_curve(step, start, curves))
        start = round(start + step.n_steps * step.step_size, _TIME_DIGITS)
    return Ids(
        materials={name: k for k, name in enumerate(names, start=1)},
        curves={name: k for k, name in enumerate(curves, start=1)},
        all_curves=curves,
        must_curves=tuple(must_curves),
    )


def _must_curve(step: Step, start: float, curves: dict[str, Curve]) -> str | None:
    """Name of the load curve under `<dtmax>`; it is added to `curves` if the step only lists times."""
    if not step.must_points or step.dt_max_curve is not None:
        return step.dt_max_curve
    largest = step.step_size if step.dt_max is None else step.dt_max
    times = (0.0, *step.must_points)
    if any(later <= earlier for earlier, later in itertools.pairwise(times)):
        raise CaseError(
            f"must-points {step.must_points} do not increase from 0",
            where="model step",
            fix="sort them, each once",
        )
    name = next(n for n in _counted("must_points") if n not in curves)
    points = tuple((round(start + time, _TIME_DIGITS) if start else time, largest) for time in times)
    curves[name] = Curve(points, interpolate="step")
    return name


def _counted(name: str) -> Iterator[str]:
    yield name
    k = 2
    while True:
        yield f"{name}_{k}"
        k += 1


def element_maps(model: LimbModel) -> dict[str, ElementMap]:
    """All element maps of all laws by name; two different maps must not share a name."""
    found: dict[str, ElementMap] = {}
    values = [each for material in model.materials.values() for each in parameter_values(material)]
    for value in (*values, model.fibres):
        if isinstance(value, ElementMap):
            _add(found, value)
    return found


def parameter_values(material: Material) -> Iterator[Value]:
    """Of a law and of all its parts."""
    yield from material.parameters.values()
    for part in material.parts:
        yield from parameter_values(part)


def node_maps(model: LimbModel) -> dict[str, NodeMap]:
    found: dict[str, NodeMap] = {}
    for owner in [model.supports, *(step.supports for step in model.steps)]:
        for support in owner:
            if isinstance(support.value, NodeMap):
                _add(found, support.value)
    return found


def _add(found: dict[str, _Map], new: _Map) -> None:
    old = found.setdefault(new.name, new)
    if old is not new and (len(old.values) != len(new.values) or (old.values != new.values).any()):
        raise CaseError(f"two maps are named {new.name!r}", where="model", fix="name each map differently")
