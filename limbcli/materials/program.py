"""Translates a `Material` into the rows of numbers that the kernels read.

`compile_material` flattens a law (with its mixtures and wrappers) into leaves; `Compiled.program` evaluates
the numbers at a time; `Compiled.derivative` returns the programs whose stress is the derivative with respect
to parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from limbcli.errors import SolveError
from limbcli.materials.kernel import kernel_of
from limbcli.materials.law import Law
from limbcli.materials.laws import LAWS, WRAPPERS
from limbcli.model import Array, Curved, ElementMap, IntArray, Material, Value

CurveAt = Callable[[str], float]


@dataclass(frozen=True, eq=False)
class Program:
    """Input of the kernels: ops (n_leaves, 3), par (1 or n_cells, n_numbers) (see `dispatch`).

    factor (n_cells,) : factor on each cell's stress, or None
    """

    ops: IntArray
    par: Array
    factor: Array | None = None


@dataclass(frozen=True)
class Leaf:
    """One elementary law of a material; `path` is its position in the mixture tree ("", "0", "1.0" ...)."""

    path: str
    law: Law
    name: str
    parameters: Mapping[str, Value]

    @property
    def n_slots(self) -> int:
        return len(self.law.slots(dict.fromkeys(self.parameters, 1.0))) + (3 if self.law.fiber else 0)


@dataclass(frozen=True, eq=False)
class Compiled:
    """A flattened material: leaves, Prony series (g0, ((g, t), ...)), prestrain (F0, ramp)."""

    name: str
    leaves: tuple[Leaf, ...]
    prony: tuple[float, tuple[tuple[float, float], ...]] | None = None
    prestrain: tuple[Array, Value] | None = None

    @property
    def varies(self) -> bool:
        """Whether a parameter follows a load curve."""
        return any(isinstance(v, Curved) for leaf in self.leaves for v in leaf.parameters.values())

    def program(self, n_cells: int, curve: CurveAt) -> Program:
        """The stress program, with load curves evaluated by `curve`."""
        columns = [c for leaf in self.leaves for c in _columns(leaf, _numbers(leaf, curve))]
        return Program(self._ops(), _stack(columns, n_cells))

    def _ops(self) -> IntArray:
        rows, offset = [], 0
        for leaf in self.leaves:
            rows.append((leaf.law.kernel.number, offset, leaf.law.extra(leaf.parameters)))
            offset += leaf.n_slots
        return np.array(rows, dtype=np.int64).reshape(-1, 3)

    def find(self, parameter: str) -> tuple[Leaf, str]:
        """The leaf and parameter name for "c1", or "0.c1" if several leaves have that parameter."""
        path, _, name = parameter.rpartition(".")
        found = [leaf for leaf in self.leaves if name in leaf.parameters and (not path or leaf.path == path)]
        if len(found) != 1:
            known = sorted(
                _address(leaf, key, self.leaves) for leaf in self.leaves for key in leaf.parameters
            )
            raise SolveError(
                f"material {self.name!r} has {'no' if not found else 'several'} parameters {parameter!r}",
                where=f"derivative with respect to {self.name}.{parameter}",
                fix=f"use one of {', '.join(known)}",
            )
        if name == "fiber":
            raise _problem(
                self.name,
                "a fibre direction is not a number to differentiate with respect to",
                "difference whole solves",
            )
        return found[0], name

    def derivative(
        self, rates: Mapping[str, float], n_cells: int, curve: CurveAt, *, weights: Array | None = None
    ) -> list[Program]:
        """Programs whose stresses sum to dS/d(theta), where parameters change by their rate times theta and
        all others are fixed.

        rates : by parameter
        weights (n_cells,) : the parameters change by weights * rate * theta, cell by cell (coefficient of an
            element map); None: by rate * theta everywhere
        """
        return [
            program
            for leaf, numbers, slopes in self._slopes(rates, curve, weights)
            for program in _derivative_programs(leaf, _columns(leaf, numbers), slopes, n_cells)
        ]

    def change(
        self, rates: Mapping[str, float], n_cells: int, curve: CurveAt, *, weights: Array | None = None
    ) -> Array:
        """d(par)/d(theta) of the program's numbers, (1 or n_cells, n_numbers)."""
        changed = {leaf.path: slopes for leaf, _, slopes in self._slopes(rates, curve, weights)}
        columns: list[Any] = []
        for leaf in self.leaves:
            own = changed.get(leaf.path, [])
            columns += [*own, *[0.0] * (leaf.n_slots - len(own))]
        return _stack(columns, n_cells)

    def _slopes(
        self, rates: Mapping[str, float], curve: CurveAt, weights: Array | None
    ) -> list[tuple[Leaf, dict[str, Any], list[Any]]]:
        """The leaves with the parameters: leaf, its parameter values, and d(slots)/d(theta)."""
        of_leaves: dict[str, tuple[Leaf, dict[str, float]]] = {}
        for parameter, rate in rates.items():
            leaf, name = self.find(parameter)
            own = of_leaves.setdefault(leaf.path, (leaf, {}))[1]
            own[name] = own.get(name, 0.0) + rate
        step, found = 1e-30, []
        for leaf, own in of_leaves.values():
            numbers = _numbers(leaf, curve)
            moved = dict(numbers)
            for name, rate in own.items():
                factor: Any = rate if weights is None else rate * weights
                value = leaf.parameters[name]
                if isinstance(value, Curved):
                    factor = np.asarray(factor) * curve(value.curve)
                moved[name] = numbers[name] + 1j * step * factor
            found.append((leaf, numbers, [np.imag(each) / step for each in leaf.law.slots(moved)]))
        return found


def _derivative_programs(leaf: Leaf, slots: list[Any], slopes: list[Any], n_cells: int) -> list[Program]:
    programs = []
    linear = {k for k in range(len(slopes)) if k not in leaf.law.derivatives}
    extra = leaf.law.extra(leaf.parameters)
    if any(np.any(slopes[k] != 0.0) for k in linear):
        columns = [slopes[k] if k in linear else slots[k] for k in range(len(slopes))]
        columns += slots[len(slopes) :]
        ops = np.array([[leaf.law.kernel.number, 0, extra]], dtype=np.int64)
        programs.append(Program(ops, _stack(columns, n_cells)))
    others = {
        slot: derivative
        for slot, derivative in leaf.law.derivatives.items()
        if slot < len(slopes) and np.any(slopes[slot] != 0.0) and derivative is not None
    }
    if leaf.law.terms and others:  # in one program: the stress of a term is proportional to its c
        scaled = list(slots)
        for slot in others:
            scaled[slot - 1] = slots[slot - 1] * slopes[slot]
        ops = np.array([[kernel.number, 0, which] for kernel, which in others.values()], dtype=np.int64)
        return [*programs, Program(ops, _stack(scaled, n_cells))]
    for slot, (kernel, which) in others.items():
        ops = np.array([[kernel.number, 0, which]], dtype=np.int64)
        factor = np.broadcast_to(np.asarray(slopes[slot], dtype=float), (n_cells,)).copy()
        programs.append(Program(ops, _stack(slots, n_cells), factor))
    return programs


def jumping(ops: IntArray, par: Array) -> Array:
    """Mask (n_leaves,) of the leaves of a program whose stress has jumps (sheared fibres)."""
    jumps = [kernel_of(number).jump for number in ops[:, 0]]
    return np.array(
        [j is not None and bool(par[:, off + j].any()) for j, off in zip(jumps, ops[:, 1], strict=True)]
    )


def compile_material(material: Material, name: str) -> Compiled:
    """Flatten a material; raises SolveError for unknown or missing laws and parameters."""
    prony, prestrain = None, None
    if material.law == "prestrain":
        prestrain = _prestrain(material, name)
        (material,) = material.parts
    if material.law == "viscoelastic":
        prony = _prony(material, name)
        (material,) = material.parts
    return Compiled(name, tuple(_leaves(material, name, "")), prony, prestrain)


def _leaves(material: Material, name: str, path: str) -> list[Leaf]:
    if material.law == "mixture":
        if not material.parts:
            raise _problem(name, "a mixture without solids", "give it at least one solid")
        inside = f"{path}." if path else ""
        return [leaf for k, part in enumerate(material.parts) for leaf in _leaves(part, name, f"{inside}{k}")]
    law = LAWS.get(material.law)
    if law is None:
        nested = material.law in WRAPPERS
        what = f"law {material.law!r} inside another law" if nested else f"law {material.law!r}"
        raise _problem(
            name,
            f"the reference solver has no {what}",
            f"use one of {', '.join((*LAWS, *WRAPPERS))}, or run FEBio",
        )
    return [Leaf(path, law, material.law, _checked(material, law, name))]


def _checked(material: Material, law: Law, name: str) -> dict[str, Value]:
    given = dict(material.parameters)
    known = {*law.parameters, *(("fiber",) if law.fiber else ())}
    unknown = sorted(set(given) - known)
    if unknown:
        raise _problem(
            name, f"law {material.law!r} has no parameter {unknown[0]!r}", f"use {', '.join(sorted(known))}"
        )
    missing = [key for key, default in law.parameters.items() if default is None and key not in given]
    missing += ["fiber"] if law.fiber and "fiber" not in given else []
    if missing:
        raise _problem(name, f"law {material.law!r} is missing {', '.join(missing)}", "give a value")
    optional = {k: value for k, value in law.parameters.items() if value is not None and not law.terms}
    if (wrong := law.check(given)) is not None:
        raise _problem(name, *wrong)
    for key in law.positive:
        value = given.get(key)
        if isinstance(value, float | int) and not value > 0:
            raise _problem(name, f"{key} = {value} is not positive", f"give a positive {key}")
    return {**optional, **given}


def _prony(material: Material, name: str) -> tuple[float, tuple[tuple[float, float], ...]]:
    values = {key: _plain(value, key, name) for key, value in material.parameters.items()}
    terms = []
    for k in range(1, 7):
        g, t = values.pop(f"g{k}", 0.0), values.pop(f"t{k}", None)
        if g != 0.0:
            if t is None or not t > 0:
                raise _problem(name, f"g{k} without a positive t{k}", f"give t{k} > 0")
            terms.append((g, t))
    g0 = values.pop("g0", 1.0)
    if values:
        raise _problem(name, f"viscoelastic has no parameter {min(values)!r}", "use g0, g1..g6, t1..t6")
    return g0, tuple(terms)


def _prestrain(material: Material, name: str) -> tuple[Array, Value]:
    gradient = material.parameters.get("F0")
    if not isinstance(gradient, tuple) or len(gradient) != 9:
        raise _problem(name, "prestrain without a constant F0 of nine numbers", "give F0 as nine numbers")
    F0 = np.array(gradient, dtype=float).reshape(3, 3)
    if not np.linalg.det(F0) > 0:
        raise _problem(name, "the prestrain gradient has no positive determinant", "correct F0")
    return F0, material.parameters.get("ramp", 1.0)


def _plain(value: Value, key: str, name: str) -> float:
    if not isinstance(value, float | int):
        raise _problem(name, f"{key} must be a plain number here", f"give one number for {key}")
    return float(value)


def _numbers(leaf: Leaf, curve: CurveAt) -> dict[str, Any]:
    """Parameter values, floats or arrays (n_cells,), with load curves evaluated."""
    return {key: _evaluate(value, curve) for key, value in leaf.parameters.items()}


def _evaluate(value: Value, curve: CurveAt) -> Any:
    if isinstance(value, Curved):
        return value.value * curve(value.curve)
    if isinstance(value, ElementMap):
        return np.asarray(value.values, dtype=float)
    if isinstance(value, tuple):
        return np.asarray(value, dtype=float)
    return float(value)


def _columns(leaf: Leaf, numbers: Mapping[str, Any]) -> list[Any]:
    columns = list(leaf.law.slots(numbers))
    if leaf.law.fiber:
        direction = np.atleast_2d(numbers["fiber"])
        length = np.linalg.norm(direction, axis=1)
        if not (length > 0).all():
            raise _problem(leaf.name, "a fibre direction has no length", "give unit vectors")
        columns += list((direction / length[:, None]).T)
    return columns


def _stack(columns: list[Any], n_cells: int) -> Array:
    arrays = [np.atleast_1d(np.asarray(each, dtype=float)) for each in columns]
    rows = max((len(each) for each in arrays), default=1)
    rows = 1 if rows == 1 else n_cells
    return np.ascontiguousarray(
        np.stack([np.broadcast_to(each, (rows,)) for each in arrays], axis=1), dtype=float
    )


def _address(leaf: Leaf, key: str, leaves: tuple[Leaf, ...]) -> str:
    alone = sum(key in each.parameters for each in leaves) == 1
    return key if alone else f"{leaf.path}.{key}"


def _problem(name: str, what: str, fix: str) -> SolveError:
    return SolveError(f"material {name!r}: {what}", where=f"material {name!r}", fix=fix)
