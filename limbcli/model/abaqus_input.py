"""Write a model as an Abaqus input file (.inp): the same mesh, sets, contact and motion; the nearest laws.

Elements are Abaqus' hybrid ones (C3D10H, C3D4H, C3D8H, C3D6H), which do not lock; their nodes are numbered as
here. A rigid body's shells become R3D3 (a quadrilateral as two). Every block is an element set of its own; a
block whose law varies from cell to cell is divided into groups, each a set with its own material.

All laws become Abaqus' Ogden form (Abaqus Theory Guide, 4.6.1), with lb = J^(-1/3) l:

    U = sum_i 2 mu_i/alpha_i^2 (lb1^alpha_i + lb2^alpha_i + lb3^alpha_i - 3) + (J - 1)^2 / D1

With mu_i = c_i/2 and alpha_i = m_i it equals FEBio's Ogden laws at J = 1. Of the change of volume only the
bulk modulus at rest, 2/D1, is kept: kappa of the uncoupled laws, lambda + 2 mu/3 of the others.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.cluster.vq import kmeans2

from limbcli.errors import CaseError
from limbcli.files.atomic import atomic_file
from limbcli.model import (
    Array,
    Block,
    Curve,
    ElementMap,
    IntArray,
    LimbModel,
    Material,
    Mesh,
    NodeMap,
    Step,
    Support,
)
from limbcli.model.bodies import Drive
from limbcli.numbers.units import kpa_from_mpa

_ELEMENTS = {"tet4": "C3D4H", "tet10": "C3D10H", "hex8": "C3D8H", "penta6": "C3D6H"}
# Corners of the faces S1, S2, ... (Abaqus Elements Guide, 28.1.4); the midside nodes follow.
_TET = ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))
_FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "tet4": _TET,
    "tet10": _TET,
    "hex8": ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
    "penta6": ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
}
_CORNERS = {"tri3": 3, "tri6": 3, "quad4": 4}
_DOFS = {"x": 1, "y": 2, "z": 3, "u": 4, "v": 5, "w": 6}
_AMPLITUDES = {"linear": "TABULAR", "smooth": "SMOOTH STEP"}
_MOST_GROUPS = 20  # of a block whose law varies
_A_LINE = 16  # numbers of a set in a line
_CONSTANTS = 8  # numbers of a material in a line
_OWN = "the small-strain bulk modulus lambda + 2 mu/3 is kept; its own volumetric part differs as J leaves 1"
_UNCOUPLED = "equal but for k/2 (ln J)^2, which becomes k/2 (J - 1)^2"
_DIFFERS = {"ogden": _OWN, "neo_hooke": _OWN, "ogden_uncoupled": _UNCOUPLED, "mooney_rivlin": _UNCOUPLED}


@dataclass(frozen=True)
class AbaqusOgden:
    """mu (n,) MPa and alpha (n,) of the terms, and D1 (1/MPa)."""

    mu: tuple[float, ...]
    alpha: tuple[float, ...]
    d1: float

    @property
    def constants(self) -> list[float]:
        """In the order of Abaqus' data lines: mu_1, alpha_1, ..., D_1, ..., D_n (0: no such term)."""
        pairs = [each for pair in zip(self.mu, self.alpha, strict=True) for each in pair]
        return [*pairs, self.d1, *[0.0] * (len(self.mu) - 1)]


def abaqus_ogden(law: str, parameters: Mapping[str, float]) -> AbaqusOgden:
    """The nearest Ogden form of a law; its parameters are those of `limbcli.materials`, as numbers.

    Raises CaseError if the law has none: it has fibres, a history or another energy.

    >>> abaqus_ogden("ogden", {"c1": 0.004, "m1": 2.0, "c2": 0.004, "m2": -2.0, "kappa": 0.4})
    AbaqusOgden(mu=(0.002, 0.002), alpha=(2.0, -2.0), d1=4.966...)
    """
    p = parameters
    if law in ("ogden", "ogden_uncoupled"):
        numbers = [k for k in range(1, 7) if p.get(f"c{k}", 0.0) != 0.0]
        mu = tuple(p[f"c{k}"] / 2 for k in numbers)
        alpha = tuple(p[f"m{k}"] for k in numbers)
        bulk = p["kappa"] + (2 * sum(mu) / 3 if law == "ogden" else 0.0)
    elif law == "mooney_rivlin":
        moduli = {2.0: 2 * p["c1"], -2.0: 2 * p.get("c2", 0.0)}
        alpha, mu = tuple(a for a, m in moduli.items() if m), tuple(m for m in moduli.values() if m)
        bulk = p["kappa"]
    elif law == "neo_hooke":
        mu, alpha, bulk = (p["mu"],), (2.0,), p["lambda"] + 2 * p["mu"] / 3
    else:
        raise CaseError(
            f"the law {law!r} has no form in Abaqus' hyperelastic laws",
            where="Abaqus input file",
            fix=f"build the model with one of the laws {', '.join(_DIFFERS)}",
        )
    return AbaqusOgden(mu, alpha, 2 / bulk)


def write_abaqus(model: LimbModel, path: Path) -> None:
    """Write the model as an input file; comments in it say what differs from this model.

    Raises CaseError if it holds what is not written: laws without Abaqus form, springs, fluid pressure,
    relative motion, loads on the tissue, load curves with steps.
    """
    _refuse(model)
    with atomic_file(path) as partial, partial.open("w", encoding="ascii", errors="replace") as file:
        for line in _lines(model):
            file.write(f"{line}\n")


def _refuse(model: LimbModel) -> None:
    drives = [*model.drives, *(each for step in model.steps for each in step.drives)]
    supports = [*model.supports, *(each for step in model.steps for each in step.supports)]
    found = [
        "springs" if model.springs else "",
        "biphasic contact" if any(each.kind != "sliding-elastic" for each in model.contacts) else "",
        "fluid pressure" if any("p" in each.dofs for each in supports) else "",
        "motion relative to an earlier step"
        if any(each.relative for each in drives) or any(each.relative for each in supports)
        else "",
        "loads on the tissue" if model.loads or any(step.loads for step in model.steps) else "",
        "load curves of kind step or by formula"
        if any(c.interpolate not in _AMPLITUDES or c.formula is not None for c in model.curves.values())
        else "",
    ]
    if any(found):
        raise CaseError(
            f"the model has {', '.join(filter(None, found))}, which is not written for Abaqus",
            where="Abaqus input file",
            fix="export the model without it, or use the .feb file",
        )


# ---------------------------------------------------------------- the file's parts


def _lines(model: LimbModel) -> Iterator[str]:
    numbers = _numbered(model.mesh)
    shells = {name for body in model.bodies for name in body.blocks}
    yield "*HEADING"
    yield "limbcli; units mm, N, s, tonne, MPa"
    yield "** All laws are in Abaqus' Ogden form; beside each stands what differs from the law of the model."
    yield "** The last nodes are the reference nodes of rigid bodies."
    yield "*NODE"
    for k, point in enumerate(model.mesh.points, 1):
        yield f"{k}, " + ", ".join(f"{value:.9g}" for value in point)
    references = {body.name: len(model.mesh.points) + k for k, body in enumerate(model.bodies, 1)}
    for body in model.bodies:
        yield f"{references[body.name]}, " + ", ".join(f"{value:.9g}" for value in body.center_of_mass)
    for block in model.mesh.blocks:
        kind = "R3D3" if block.name in shells else _ELEMENTS.get(block.kind, "R3D3")
        yield f"*ELEMENT, TYPE={kind}, ELSET={_name(block.name)}"
        for number, nodes in zip(numbers[block.name], _cells(block), strict=True):
            yield f"{number}, " + ", ".join(str(each + 1) for each in nodes)
    for name, nodes in model.mesh.node_sets.items():
        yield f"*NSET, NSET={_name(name)}"
        yield from _rows(nodes + 1)
    for name, surface in model.mesh.surfaces.items():
        yield f"*SURFACE, TYPE=ELEMENT, NAME=SURF_{_name(name)}"
        yield from _facets(model.mesh, surface.facets, numbers)
    for domain in model.domains:
        yield from _material(model, domain.block, domain.material, numbers)
    for body in model.bodies:
        reference = references[body.name]
        yield f"*NSET, NSET=REF_{_name(body.name)}"
        yield str(reference)
        tied = [f"NODE_SET_{_name(body.name)}"] if body.node_sets else []
        for each in tied:
            yield f"*NSET, NSET={each}"
            yield ", ".join(_name(name) for name in body.node_sets)
        if body.blocks:
            yield f"*ELSET, ELSET=BODY_{_name(body.name)}"
            yield ", ".join(_name(name) for name in body.blocks)
        of_shells = f", ELSET=BODY_{_name(body.name)}" if body.blocks else ""
        of_nodes = f", TIE NSET={tied[0]}" if tied else ""
        yield f"*RIGID BODY, REF NODE={reference}{of_shells}{of_nodes}"
    for name, curve in model.curves.items():
        yield from _amplitude(name, curve)
    for contact in model.contacts:
        name = _name(contact.name)
        yield "** hard contact; FEBio's penalty and augmentation have no counterpart here"
        yield f"*SURFACE INTERACTION, NAME={name}"
        if contact.friction:
            yield "*FRICTION"
            yield f"{contact.friction:.9g},"
        yield f"*CONTACT PAIR, INTERACTION={name}, TYPE=SURFACE TO SURFACE"
        yield f"SURF_{_name(contact.primary)}, SURF_{_name(contact.secondary)}"
    fixed = [_boundary(each, None) for each in model.supports if each.value is None]
    fixed += [_drive(each, references) for each in model.drives if each.kind == "fixed"]
    yield from (line for each in fixed for line in each)
    moved = [each for each in model.supports if each.value is not None]
    driven = [each for each in model.drives if each.kind != "fixed"]
    for k, step in enumerate(model.steps, 1):
        yield from _step(k, step, moved if k == 1 else [], driven if k == 1 else [], model, references)


def _step(
    number: int, step: Step, supports: list[Support], drives: list[Drive], model: LimbModel,
    references: Mapping[str, int],
) -> Iterator[str]:  # fmt: skip
    period = step.n_steps * step.step_size
    most = min(step.dt_max or step.step_size, period)
    if step.must_points:
        yield f"*TIME POINTS, NAME=LEVELS_{number}"
        yield from _rows(step.must_points, form="{:.9g}")
    yield f"*STEP, NAME=STEP_{number}, NLGEOM=YES, INC=10000"
    yield "*STATIC"
    yield f"{min(step.step_size, most):.9g}, {period:.9g}, {min(step.dt_min, most) * 1e-3:.9g}, {most:.9g}"
    for support in (*supports, *step.supports):
        yield from _boundary(support, model)
    for drive in (*drives, *step.drives):
        yield from _drive(drive, references)
    at = f", TIME POINTS=LEVELS_{number}" if step.must_points else ", FREQUENCY=1"
    yield f"*OUTPUT, FIELD{at}"
    yield "*NODE OUTPUT"
    yield "U,"
    yield "*ELEMENT OUTPUT"
    yield "S, LE"
    for body in model.bodies:
        yield "*OUTPUT, HISTORY"
        yield f"*NODE OUTPUT, NSET=REF_{_name(body.name)}"
        yield "U, RF"
    yield "*END STEP"


def _boundary(support: Support, model: LimbModel | None) -> Iterator[str]:
    amplitude = f", AMPLITUDE={_name(support.curve)}" if support.curve else ""
    yield f"*BOUNDARY{amplitude}"
    for dof in support.dofs:
        axis = _DOFS[dof]
        if isinstance(support.value, NodeMap) and model is not None:
            nodes = model.mesh.node_sets[support.node_set]
            for node, value in zip(nodes, support.value.values, strict=True):
                yield f"{node + 1}, {axis}, {axis}, {value:.9g}"
        elif isinstance(support.value, NodeMap) or support.value is None:
            yield f"{_name(support.node_set)}, {axis}, {axis}"
        else:
            yield f"{_name(support.node_set)}, {axis}, {axis}, {support.value:.9g}"


def _drive(drive: Drive, references: Mapping[str, int]) -> Iterator[str]:
    amplitude = f", AMPLITUDE={_name(drive.curve)}" if drive.curve and drive.kind != "fixed" else ""
    axis, node = _DOFS[drive.dof], references[drive.body]
    if drive.kind == "fixed":
        yield "*BOUNDARY"
        yield f"{node}, {axis}, {axis}"
    elif drive.is_load:
        yield f"*CLOAD{amplitude}"
        yield f"{node}, {axis}, {drive.value:.9g}"
    else:
        yield f"*BOUNDARY{amplitude}"
        yield f"{node}, {axis}, {axis}, {drive.value:.9g}"


def _amplitude(name: str, curve: Curve) -> Iterator[str]:
    yield f"*AMPLITUDE, NAME={_name(name)}, DEFINITION={_AMPLITUDES[curve.interpolate]}, TIME=TOTAL TIME"
    flat = [value for point in curve.points for value in point]
    yield from _rows(flat, form="{:.9g}", length=8)


# ---------------------------------------------------------------- materials


def _material(
    model: LimbModel, block_name: str, material_name: str, numbers: Mapping[str, IntArray]
) -> Iterator[str]:
    """Sections and materials of a block: one, or one for each group of cells with like parameters."""
    material, block = model.materials[material_name], model.mesh.block(block_name)
    if material.parts or material.law not in _DIFFERS:
        abaqus_ogden(material.law if not material.parts else f"{material.law} of several parts", {})
    rows, names = _parameters(material, len(block.cells))
    group = _groups(rows)
    n_groups = int(group.max(initial=0)) + 1
    for k in range(n_groups):
        chosen = group == k
        label = _name(block_name) if n_groups == 1 else f"{_name(block_name)}_G{k + 1:02d}"
        if n_groups > 1:
            yield f"*ELSET, ELSET={label}"
            yield from _rows(numbers[block_name][chosen])
        law = abaqus_ogden(material.law, dict(zip(names, rows[chosen].mean(axis=0).tolist(), strict=True)))
        yield f"*SOLID SECTION, ELSET={label}, MATERIAL=MAT_{label}"
        yield f"*MATERIAL, NAME=MAT_{label}"
        yield f"** {material.law} of the model ({material_name}): {_DIFFERS[material.law]}"
        shear, bulk = kpa_from_mpa(sum(law.mu)), kpa_from_mpa(2 / law.d1)
        yield f"** shear modulus at rest {shear:.6g} kPa, bulk modulus {bulk:.6g} kPa"
        if n_groups > 1:
            yield f"** group {k + 1} of {n_groups}, means over {int(chosen.sum())} elements"
        yield f"*HYPERELASTIC, OGDEN, N={len(law.mu)}"
        yield from _rows(law.constants, form="{:.9g}", length=_CONSTANTS)
        yield "*DENSITY"
        yield f"{material.density:.9g},"


def _parameters(material: Material, n_cells: int) -> tuple[Array, list[str]]:
    """Values (n_cells, n) of the parameters by name."""
    columns = []
    for name, value in material.parameters.items():
        if isinstance(value, ElementMap):
            columns.append(np.asarray(value.values, np.float64))
        elif isinstance(value, (int, float)):
            columns.append(np.full(n_cells, float(value)))
        else:
            raise CaseError(
                f"the parameter {name} of the law {material.law!r} changes with time or is a vector",
                where="Abaqus input file",
                fix="export a model with constant parameters",
            )
    return np.column_stack(columns), list(material.parameters)


def _groups(rows: Array) -> IntArray:
    """A group number for each row (n, k): the same for equal rows, or, if there are many, for like ones.

    >>> _groups(np.array([[2.0, 1.0], [1.0, 1.0], [2.0, 1.0]])).tolist()
    [1, 0, 1]
    """
    unlike, inverse = np.unique(rows, axis=0, return_inverse=True)
    if len(unlike) <= _MOST_GROUPS:
        return np.asarray(inverse).reshape(-1)
    scaled = rows / np.maximum(np.abs(rows).mean(axis=0), 1e-300)
    rank = np.argsort(np.argsort(scaled[:, int(np.argmax(np.ptp(scaled, axis=0)))], kind="stable"))
    first = rank * _MOST_GROUPS // len(rows)
    middles = np.array([scaled[first == k].mean(axis=0) for k in range(_MOST_GROUPS)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a group has lost all of its rows to others
        like = kmeans2(scaled, middles, minit="matrix")[1]
    return np.asarray(np.unique(like, return_inverse=True)[1])


# ---------------------------------------------------------------- numbers and names


def _numbered(mesh: Mesh) -> dict[str, IntArray]:
    """Element numbers, from 1, of the cells of each block as they are written."""
    found, last = {}, 0
    for block in mesh.blocks:
        n = len(_cells(block))
        found[block.name] = last + 1 + np.arange(n)
        last += n
    return found


def _cells(block: Block) -> IntArray:
    """The cells as they are written: of shells the corners, of quadrilaterals two triangles each."""
    if block.is_solid:
        return block.cells
    if block.kind == "quad4":
        return block.cells[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    return block.cells[:, :3]


def _facets(mesh: Mesh, facets: Mapping[str, IntArray], numbers: Mapping[str, IntArray]) -> Iterator[str]:
    """Lines `element, face` of a surface's facets.

    Raises CaseError if a facet belongs to no element.
    """
    wanted: dict[tuple[int, ...], list[int]] = {}
    for kind, rows in facets.items():
        for corners in rows[:, : _CORNERS[kind]].tolist():
            wanted[tuple(sorted(corners))] = corners
    nodes = np.unique([node for each in wanted for node in each]).astype(np.int64)
    lines, found = [], set()
    for block in mesh.blocks:
        parts = _FACES[block.kind] if block.is_solid else (tuple(range(_CORNERS[block.kind])),)
        per_cell = 2 if block.kind == "quad4" else 1
        for face, part in enumerate(parts, 1):
            faces = block.cells[:, part]
            for cell in np.flatnonzero(np.isin(faces, nodes).all(axis=1)).tolist():
                corners = faces[cell].tolist()
                facet = wanted.get(key := tuple(sorted(corners)))
                if facet is None:
                    continue
                found.add(key)
                side = (
                    f"S{face}" if block.is_solid else "SPOS" if _is_turned_alike(corners, facet) else "SNEG"
                )
                own = numbers[block.name][per_cell * cell : per_cell * (cell + 1)]
                lines += [f"{number}, {side}" for number in own]
    if len(found) < len(wanted):
        raise CaseError(
            f"{len(wanted) - len(found)} facets of a surface belong to no element",
            where="Abaqus input file",
            fix="mesh again",
        )
    yield from lines


def _is_turned_alike(one: list[int], other: list[int]) -> bool:
    """
    >>> _is_turned_alike([1, 2, 3], [3, 1, 2]), _is_turned_alike([1, 2, 3], [3, 2, 1])
    (True, False)
    """
    at = other.index(one[0])
    return other[at:] + other[:at] == one


def _rows(values: Iterable[float], *, form: str = "{}", length: int = _A_LINE) -> Iterator[str]:
    words = [form.format(each) for each in values]
    for k in range(0, len(words), length):
        yield ", ".join(words[k : k + length])


def _name(text: str) -> str:
    """A label of Abaqus: letters, digits and _, a letter first, 60 at most.

    >>> _name("probe tips"), _name("1st")
    ('PROBE_TIPS', 'N_1ST')
    """
    name = re.sub(r"\W", "_", text, flags=re.ASCII).upper()[:60]
    return name if name[:1].isalpha() else f"N_{name}"
