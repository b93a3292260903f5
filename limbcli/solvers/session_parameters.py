"""The parameters that a session differentiates by, named by (material, parameter)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array, ElementMap, LimbModel, Material

if TYPE_CHECKING:
    from limbcli.fem.derivatives.parameters import LawParameter, Prestrain, Tied

Parameter = tuple[str, str]
_GRADIENT = "F0"


def tied_parts(name: str) -> list[tuple[str, float]]:
    """The parameters behind a name, and how far each moves.

    >>> tied_parts("m1-m2"), tied_parts("0.c1")
    ([('m1', 1.0), ('m2', -1.0)], [('0.c1', 1.0)])
    """
    return [(part, -1.0 if sign == "-" else 1.0) for sign, part in re.findall(r"([+-]?)([^+-]+)", name)]


def law_parameter(key: Parameter, weights: Array | None, model: LimbModel) -> LawParameter | Tied | Prestrain:
    """What a key stands for; of a prestrained material "ramp" is its prestrain's, and "F0", or "F0" with any
    ending, its gradient, whose nine numbers move by `weights`."""
    from limbcli.fem.derivatives.parameters import LawParameter, Prestrain, Tied

    material, name = key
    if model.materials[material].law == "prestrain":
        if name == "ramp":
            return Prestrain(material)
        if name.startswith(_GRADIENT):
            if weights is None or np.size(weights) != 9:
                raise SolveError(
                    f"how the nine numbers of {name} move is not told",
                    where="derivative with respect to a prestrain",
                    fix="give `weights` of nine numbers",
                )
            return Prestrain(material, np.reshape(weights, (3, 3)))
    parts = tied_parts(name)
    if len(parts) == 1:
        return LawParameter(material, name, weights=weights)
    return Tied(tuple((LawParameter(material, part, weights=weights), rate) for part, rate in parts))


def parameter_values(
    model: LimbModel, wrt: Sequence[Parameter], weights: Mapping[Parameter, Array]
) -> dict[Parameter, float]:
    """Every number of the model's laws; of a map along `weights` its coefficient; of tied ones the first."""
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
    """A material, or what it is prestrained of: their parameters are named alike."""
    material = model.materials[name]
    return material.parts[0] if material.law == "prestrain" else material


def nudged(model: LimbModel, name: Parameter, relative: float) -> tuple[LimbModel, float]:
    """The model with one parameter moved by a part of itself, and by how much (unsigned)."""
    material = model.materials[name[0]]
    owner = material
    while name[1] not in owner.parameters and len(owner.parts) == 1:
        owner = owner.parts[0]
    value = owner.parameters.get(name[1])
    if not isinstance(value, float | int) or value == 0:
        raise SolveError(
            f"{name[0]}.{name[1]} cannot be differenced: it is {value!r}",
            where="derivative of a path-dependent response",
            fix="choose a parameter that is a number other than 0",
        )
    moved = owner.with_parameters(**{name[1]: value * (1 + relative)})
    if owner is not material:
        moved = replace(material, parts=(moved,))
    return model.with_material(name[0], moved), abs(value * relative)
