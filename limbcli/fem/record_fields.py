"""Record fields: values of nodes, cells and bodies at a converged state.

Cell fields are averaged over the integration points, including positions and principal stresses, as in
FEBio's log. A rigid cell has J = 1, F = 1, zero stress and its initial position.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.elements.element import shape
from limbcli.fem.elements.element_loops import states_at_points
from limbcli.fem.elements.mean_dilatation import pressures
from limbcli.fem.elements.quadrature import rule
from limbcli.fem.equilibrium.history import elastic_stress
from limbcli.fem.motion.state import Forces, State
from limbcli.fem.system import System
from limbcli.materials.energy import energy_density, viscoelastic_energy
from limbcli.materials.tensors import FIRST, SECOND, VOIGT
from limbcli.model import Array, IntArray, LogRecord

_TENSOR = {"x": (0, 0), "y": (1, 1), "z": (2, 2), "xy": (0, 1), "yz": (1, 2), "xz": (0, 2)}
# FEBio 4.11 writes the first 21 entries, row by row, of the 6x6 spatial tangent (order xx yy zz xy yz xz)
# under these names, even where name and entry do not correspond; done here too, to give the same file.
TANGENT_FIELDS = (
    "cxxxx", "cxxyy", "cyyyy", "cxxzz", "cyyzz", "czzzz", "cxxxy", "cyyxy", "czzxy", "cxyxy", "cxxyz",
    "cyyyz", "czzyz", "cxyyz", "cyzyz", "cxxxz", "cyyxz", "czzxz", "cxyxz", "cyzxz", "cxzxz",
)  # fmt: skip
# By field of a cell: the quantity that it is a component of, and which.
_COMPONENTS: Mapping[str, tuple[str, tuple[int, ...]]] = {
    "J": ("J", ()),
    "sed": ("sed", ()),
    **{f"{letter}{k}": (f"principal {letter}", (k - 1,)) for letter in "sEU" for k in (1, 2, 3)},
    **{axis: ("place", (k,)) for k, axis in enumerate("xyz")},
    **{f"{letter}{name}": (letter, at) for letter in "sEU" for name, at in _TENSOR.items()},
    **{f"F{a}{b}": ("F", (i, j)) for i, a in enumerate("xyz") for j, b in enumerate("xyz")},
    **{name: ("tangent", divmod(k, 6)) for k, name in enumerate(TANGENT_FIELDS)},
}
CELL_FIELDS = tuple(_COMPONENTS)
STRESS_FIELDS = tuple(name for name, (of, _) in _COMPONENTS.items() if of in ("s", "principal s"))
_ONES_AT_REST = ("J", "Ux", "Uy", "Uz", "U1", "U2", "U3", "Fxx", "Fyy", "Fzz")
NODE_FIELDS = ("x", "y", "z", "ux", "uy", "uz", "Rx", "Ry", "Rz")
BODY_FIELDS = ("x", "y", "z", "thx", "thy", "thz", "Fx", "Fy", "Fz", "Mx", "My", "Mz")
_KNOWN = {"element": CELL_FIELDS, "node": NODE_FIELDS, "rigid_body": BODY_FIELDS}


def check_record(record: LogRecord) -> None:
    """Raise SolveError for a record with an unsupported field."""
    for name in record.fields:
        if name not in _KNOWN[record.kind]:
            raise SolveError(
                f"the log variable {name!r} is not supported by the reference solver",
                where=f"record {record.file!r}",
                fix=f"use {', '.join(_KNOWN[record.kind])}, or run FEBio",
            )


def record_rows(system: System, state: State, forces: Forces, record: LogRecord) -> tuple[IntArray, Array]:
    """Item numbers (from 0) and values (n_items, n_fields) of one record."""
    if record.kind == "rigid_body":
        return _body_rows(system, state, forces, record)
    if record.kind == "node":
        return _node_rows(system, state, forces, record)
    return _cell_rows(system, state, record)


def _body_rows(system: System, state: State, forces: Forces, record: LogRecord) -> tuple[IntArray, Array]:
    names = [body.name for body in system.bodies]
    if record.items not in names:
        raise SolveError(
            f"there is no rigid body {record.items!r}",
            where=f"record {record.file!r}",
            fix=f"use one of {names}",
        )
    b = names.index(str(record.items))
    at = state.bodies[b]
    values = np.concatenate([system.bodies[b].center + at.shift, at.rotation, forces.bodies[b]])
    columns = [BODY_FIELDS.index(name) for name in record.fields]
    return np.array([b], dtype=np.int64), values[None, columns]


def _node_rows(system: System, state: State, forces: Forces, record: LogRecord) -> tuple[IntArray, Array]:
    reactions = np.where(system.driven, forces.nodal, 0.0)
    values = np.concatenate([system.X + state.u, state.u, reactions], axis=1)
    items = np.arange(len(values)) if record.items is None else np.asarray(record.items)
    return items, values[items][:, [NODE_FIELDS.index(name) for name in record.fields]]


def _cell_rows(system: System, state: State, record: LogRecord) -> tuple[IntArray, Array]:
    n_cells = sum(len(block.cells) for block in system.model.mesh.blocks)
    values = np.zeros((n_cells, len(record.fields)))
    for k, name in enumerate(record.fields):
        of, at = _COMPONENTS[name]
        if name in _ONES_AT_REST:
            values[:, k] = 1.0
        if of == "place":
            values[:, k] = _mean_places(system)[:, at[0]]
    for number, group in enumerate(system.groups):
        rows = cell_fields(system, state, number, record.fields)
        values[group.first : group.first + len(group.cells)] = rows
    items = np.arange(n_cells) if record.items is None else np.asarray(record.items)
    return items, values[items]


def _mean_places(system: System) -> Array:
    """Mean initial positions (n_cells, 3) of the integration points of all cells, which FEBio logs for rigid
    ones."""
    blocks = system.model.mesh.blocks
    shares = [shape(block.kind, rule(block.kind)[0])[0].mean(axis=0) for block in blocks]
    places = [np.einsum("k,cki->ci", s, system.X[b.cells]) for s, b in zip(shares, blocks, strict=True)]
    return np.concatenate(places)


def gauss_fields(system: System, state: State, number: int) -> tuple[Array, Array]:
    """F of the mesh (without prestrain) and Cauchy stress of a group, both (n_cells, n_gauss, 3, 3)."""
    o = system.operands[number]
    F, S, _ = states_at_points(system.threads, o, state.u)
    J = np.linalg.det(F)
    stress = F @ S[..., VOIGT] @ np.swapaxes(F, -1, -2) / J[..., None, None]
    if o.bulk is not None:
        stress += pressures(o, J)[:, None, None, None] * np.eye(3)
    return F @ np.linalg.inv(o.base), stress


def columns_of(fields: tuple[str, ...], quantities: Mapping[str, Callable[[], Array]]) -> Array:
    """Columns (n_cells, n_fields) of fields of cells, averaged over the integration points.

    quantities : gives the values (n_cells, n_gauss, ...) of what fields are components of
    """
    several = [_COMPONENTS[name] for name in fields]
    known = {name: quantities[name]() for name in {of for of, _ in several}}
    columns = [_component(known[of], at).mean(axis=1) for of, at in several]
    return np.stack(columns, axis=1)


def _component(values: Array, at: tuple[int, ...]) -> Array:
    """A component (n_cells, n_gauss) of values (n_cells, n_gauss, ...)."""
    index: tuple[slice | int, ...] = (slice(None), slice(None), *at)
    return values[index]


def cell_fields(system: System, state: State, number: int, fields: tuple[str, ...]) -> Array:
    """Fields (n_cells, n_fields) of a group's cells, averaged over the integration points."""
    group = system.groups[number]
    F, stress = gauss_fields(system, state, number)
    C = np.swapaxes(F, -1, -2) @ F
    tensors: dict[str, Callable[[], Array]] = {
        "s": lambda: stress, "E": lambda: 0.5 * (C - np.eye(3)), "U": lambda: right_stretch(C),
    }  # fmt: skip
    x = (system.X + state.u)[group.cells]
    return columns_of(fields, {
        "J": lambda: np.linalg.det(F),
        "sed": lambda: _energy(system, state, number, F, stress),
        "place": lambda: np.einsum("k,cki->ci", group.shares, x)[:, None],
        "F": lambda: F,
        "tangent": lambda: spatial_tangent(system, state, number).mean(axis=1, keepdims=True),
        **tensors,
        **{f"principal {name}": partial(_principal, tensor) for name, tensor in tensors.items()},
    })  # fmt: skip


def _principal(tensor: Callable[[], Array]) -> Array:
    """Mean principal values (n_cells, 1, 3) of a tensor at a group's points, largest first."""
    return np.asarray(np.linalg.eigvalsh(tensor()).mean(axis=1, keepdims=True)[..., ::-1])


def _energy(system: System, state: State, number: int, F: Array, stress: Array) -> Array:
    """Energy density (n_cells, n_gauss) as FEBio logs it: that of a law with prestrain is 0."""
    material = system.groups[number].material
    if material.prestrain is not None:
        return np.zeros(F.shape[:2])
    if material.prony is None:
        return energy_density(system.operands[number].complete(), F)
    inverse = np.linalg.inv(F)
    S = np.linalg.det(F)[..., None, None] * (inverse @ stress @ np.swapaxes(inverse, -1, -2))
    elastic = elastic_stress(system, state, number)[..., VOIGT]
    return viscoelastic_energy(system.operands[number], F, material.prony, S - elastic)


def right_stretch(C: Array) -> Array:
    """U (..., 3, 3), the square root of C = F'F.

    >>> right_stretch(np.diag([4.0, 1.0, 9.0])).round(12).tolist()
    [[2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]]
    """
    squares, axes = np.linalg.eigh(C)
    return np.asarray(np.einsum("...ia,...a,...ja->...ij", axes, np.sqrt(squares), axes))


def spatial_tangent(system: System, state: State, number: int) -> Array:
    """Spatial tangent c_ijkl = F_iI F_jJ F_kK F_lL CC_IJKL / J as (n_cells, n_gauss, 6, 6), Voigt order."""
    o = system.operands[number].complete()
    F, _, CC = states_at_points(system.threads, o, state.u, tangent=True)
    return pushed(F, CC)


def pushed(F: Array, CC: Array) -> Array:
    """Push-forward (..., 6, 6) of CC by F (..., 3, 3), over det F."""
    push = pair_push(F, F)
    return np.asarray(push @ CC @ np.swapaxes(push, -1, -2) / np.linalg.det(F)[..., None, None])


def pair_push(A: Array, B: Array) -> Array:
    """Matrix (..., 6, 6) mapping the Voigt components of a symmetric T to those of A T B'."""
    push = np.zeros((*A.shape[:-2], 6, 6))
    for p in range(6):
        for q in range(6):
            i, j, k, l = FIRST[p], SECOND[p], FIRST[q], SECOND[q]
            push[..., p, q] = A[..., i, k] * B[..., j, l]
            if k != l:
                push[..., p, q] += A[..., i, l] * B[..., j, k]
    return push
