"""The parameters by which a session differentiates, named by (material, parameter)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array, Curved, ElementMap, LimbModel, Material, Value

if TYPE_CHECKING:
    from limbcli.fem.derivatives.parameters import LawParameter, Prestrain

Parameter = tuple[str, str]
_GRADIENT = "F0"


def tied_parts(name: str) -> list[tuple[str, float]]:
    """The parameters that a name combines, and the rate at which each changes.

    >>> tied_parts("m1-m2"), tied_parts("0.c1")
    ([('m1', 1.0), ('m2', -1.0)], [('0.c1', 1.0)])
    """
    return [(part, -1.0 if sign == "-" else 1.0) for sign, part in re.findall(r"([+-]?)([^+-]+)", name)]


def check_materials(wrt: Sequence[Parameter], model: LimbModel) -> None:
    """Refuse parameters of materials that the model does not have."""
    for material, name in wrt:
        if material not in model.materials:
            raise SolveError(
                f"the model has no material {material!r}",
                where=f"derivative with respect to {material}.{name}",
                fix=f"use one of {', '.join(sorted(model.materials))}",
            )


def law_parameter(key: Parameter, weights: Array | None, model: LimbModel) -> LawParameter | Prestrain:
    """The differentiable parameter that a key names.

    For a prestrained material, "ramp" is the ramp of its prestrain, and "F0", with any suffix, its prestrain
    gradient, whose nine numbers change by `weights`.

    Raises SolveError if "F0" is requested without nine weights.
    """
    from limbcli.fem.derivatives.parameters import LawParameter, Prestrain

    material, name = key
    if model.materials[material].law == "prestrain":
        if name == "ramp":
            return Prestrain(material)
        if name.startswith(_GRADIENT):
            if weights is None or np.size(weights) != 9:
                raise SolveError(
                    f"how the nine numbers of {name} vary is not given",
                    where="derivative with respect to a prestrain",
                    fix="give `weights` of nine numbers",
                )
            return Prestrain(material, np.reshape(weights, (3, 3)))
    return LawParameter(material, dict(tied_parts(name)), weights)


def parameter_values(
    model: LimbModel, wrt: Sequence[Parameter], weights: Mapping[Parameter, Array]
) -> dict[Parameter, float]:
    """The current value of every scalar parameter of the model's laws, and of the parameters in `wrt`.

    For an element map, or a prestrain gradient, the value is its projection onto `weights`; for combined
    parameters that of the first.
    """
    out: dict[Parameter, float] = {}
    for material in model.materials:
        for name, value in _own(model, material).parameters.items():
            if isinstance(value, float | int):
                out[material, name] = float(value)
    for material, name in wrt:
        along = weights.get((material, name))
        gradient = model.materials[material].parameters.get(_GRADIENT)
        if name.startswith(_GRADIENT) and isinstance(gradient, tuple) and along is not None:
            out[material, name] = float(np.ravel(along) @ np.array(gradient) / np.sum(np.square(along)))
            continue
        first = _own(model, material).parameters.get(tied_parts(name)[0][0])
        if isinstance(first, float | int):
            out[material, name] = float(first)
        elif isinstance(first, ElementMap) and along is not None:
            out[material, name] = float(along @ first.values / (along @ along))
    return out


def _own(model: LimbModel, name: str) -> Material:
    """A material, or for a prestrained one the material it wraps, whose parameter names it shares."""
    material = model.materials[name]
    return material.parts[0] if material.law == "prestrain" else material


def nudged(
    model: LimbModel, name: Parameter, relative: float, *, along: Array | None = None
) -> tuple[LimbModel, float]:
    """The model with a parameter changed by a fraction `relative` of itself, and the size of the change.

    Combined parameters change together, by a fraction of the first. A map changes uniformly, or along
    `along` (n_cells,), and a prestrain gradient along its nine numbers, by a fraction of the largest entry.

    Raises SolveError if the material has no such parameter, or several, or its value cannot be changed by a
    fraction of itself: it is zero, not a number or map, or `along` is missing or does not fit.
    """
    material = model.materials[name[0]]
    is_gradient = material.law == "prestrain" and name[1].startswith(_GRADIENT)
    step = 0.0
    for part, rate in [(_GRADIENT, 1.0)] if is_gradient else tied_parts(name[1]):
        at, _, key = part.rpartition(".")
        found = [each for each in _tree(material) if key in each[2].parameters and at in ("", each[1])]
        value = found[0][2].parameters[key] if len(found) == 1 else None
        step = step or abs(relative) * _size(value, along)
        if _size(value, along) == 0.0:
            several = "one of several" if len(found) > 1 else repr(value)
            raise SolveError(
                f"{name[0]}.{part} cannot be differenced: it is {several}",
                where="derivative of a path-dependent response",
                fix="choose a parameter that is a number other than 0, or a map or gradient with `weights`",
            )
        ((route, _, owner),) = found
        moved = _moved(value, rate * step if relative > 0 else -rate * step, along)
        material = _with_part(material, route, owner.with_parameters(**{key: moved}))
    return model.with_material(name[0], material), step


def _tree(
    material: Material, route: tuple[int, ...] = (), at: str = ""
) -> Iterator[tuple[tuple[int, ...], str, Material]]:
    """A material and its nested parts: (index route, prefix as in "0.c1", material)."""
    yield route, at, material
    for k, part in enumerate(material.parts):
        place = at if material.law != "mixture" else f"{at}.{k}" if at else str(k)
        yield from _tree(part, (*route, k), place)


def _with_part(material: Material, route: tuple[int, ...], part: Material) -> Material:
    if not route:
        return part
    parts = list(material.parts)
    parts[route[0]] = _with_part(parts[route[0]], route[1:], part)
    return replace(material, parts=tuple(parts))


def _size(value: Value | None, along: Array | None) -> float:
    """The magnitude that a relative step refers to; 0 if the parameter cannot be changed."""
    if isinstance(value, float | int | Curved):
        return abs(value.value if isinstance(value, Curved) else value) if along is None else 0.0
    if value is None or (along is None and not isinstance(value, ElementMap)):
        return 0.0
    values = np.asarray(value.values if isinstance(value, ElementMap) else value, dtype=float)
    way = np.ones(values.size) if along is None else np.ravel(along)
    if values.shape != way.shape or not way.any():
        return 0.0
    return float(abs(values).max() / abs(way).max())


def _moved(value: Value | None, step: float, along: Array | None) -> Value:
    if isinstance(value, Curved):
        return replace(value, value=value.value + step)
    if isinstance(value, ElementMap):
        return replace(value, values=value.values + step * (1.0 if along is None else np.ravel(along)))
    if isinstance(value, tuple):
        return tuple((np.array(value) + step * np.ravel(np.asarray(along))).tolist())
    assert value is not None
    return value + step
