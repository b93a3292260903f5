"""Pure changes of a model's tissue used by several effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array, Block, ElementMap, LimbModel, Material, Value
from limbcli.model.patient_frame import HEAD, patient_from_model

TISSUE = "tissue"  # name of the tissue's material
WRAPPERS = ("prestrain", "biphasic", "viscoelastic")  # laws that wrap a whole tissue, outermost first
# Barycentric coordinates of points on a facet, in sixths.
_SPREAD = (
    (6, 0, 0), (0, 6, 0), (0, 0, 6), (3, 3, 0), (0, 3, 3), (3, 0, 3), (2, 2, 2), (4, 1, 1), (1, 4, 1),
    (1, 1, 4),
)  # fmt: skip
# Parameters that are stiffnesses or stresses: scaling all of them scales the law.
_STIFFNESSES = ("c1", "c2", "c3", "c4", "c5", "c6", "kappa", "ksi", "mu", "lambda", "T0")


def tissue_block(model: LimbModel) -> Block:
    """The block whose material is the tissue.

    Raises SolveError if there is none, or more than one.
    """
    names = [each.block for each in model.domains if each.material == TISSUE]
    if len(names) != 1:
        raise SolveError(
            f"{len(names)} blocks are made of {TISSUE!r}",
            where="effect",
            fix="give the model one tissue block",
        )
    return model.mesh.block(names[0])


def core(material: Material) -> Material:
    """The innermost elastic law of a material: itself, or the first solid of a mixture, without wrappers."""
    while material.parts:
        material = material.parts[0]
    return material


def ground_modulus(model: LimbModel) -> float:
    """c = 2 mu of the tissue's elastic law (MPa): the sum of its c_k, with a map represented by its mean."""
    parameters = core(model.materials[TISSUE]).parameters
    total = 0.0
    for k in range(1, 7):
        value = parameters.get(f"c{k}", 0.0)
        total += float(np.mean(value.values)) if isinstance(value, ElementMap) else float(value)  # type: ignore[arg-type]
    return total


def with_core(model: LimbModel, changed: Material) -> LimbModel:
    """The model with the innermost elastic law of its tissue replaced."""

    def swap(material: Material) -> Material:
        if not material.parts:
            return changed
        return replace(material, parts=(swap(material.parts[0]), *material.parts[1:]))

    return model.with_material(TISSUE, swap(model.materials[TISSUE]))


def within(material: Material, laws: Sequence[str], change: Callable[[Material], Material]) -> Material:
    """A material changed inside wrappers of these laws; without any wrapper, all of it is changed."""
    if material.law not in laws:
        return change(material)
    return replace(material, parts=(within(material.parts[0], laws, change),))


def with_part(model: LimbModel, part: Material) -> LimbModel:
    """Add a solid in parallel to the tissue's: a mixture, inside the wrappers of the whole tissue."""

    def beside(tissue: Material) -> Material:
        solids = tissue.parts if tissue.law == "mixture" else (tissue,)
        return Material("mixture", {}, (*solids, part), tissue.density)

    return model.with_material(TISSUE, within(model.materials[TISSUE], WRAPPERS, beside))


def scaled(model: LimbModel, factor: Array) -> LimbModel:
    """The tissue's stiffness multiplied by `factor` (n_cells,), cell by cell; all of its solids alike."""
    block = tissue_block(model)

    def scale(material: Material, path: str) -> Material:
        parts = tuple(scale(each, f"{path}{k}") for k, each in enumerate(material.parts))
        changes: dict[str, Value] = {}
        for name, value in material.parameters.items():
            if name in _STIFFNESSES and isinstance(value, int | float | ElementMap):
                base = value.values if isinstance(value, ElementMap) else float(value)
                changes[name] = ElementMap(f"{TISSUE}{path}_{name}", block.name, base * factor)
        return replace(material, parts=parts, parameters={**material.parameters, **changes})

    return model.with_material(TISSUE, scale(model.materials[TISSUE], ""))


def skin_points(model: LimbModel) -> Array:
    """Points distributed over the skin's facets, dense enough for the nearest one to give the distance to the
    skin."""
    surface = model.mesh.surfaces.get("skin")
    if surface is None:
        raise SolveError("the model has no surface `skin`", where="effect", fix="mesh again")
    points = []
    weights = [np.array(each) / 6 for each in _SPREAD]
    for facets in surface.facets.values():
        corners = model.mesh.points[facets[:, :3]]
        points += [np.einsum("k,nkd->nd", w, corners) for w in weights]
        if facets.shape[1] == 4:
            points.append(model.mesh.points[facets].mean(axis=1))
    return np.concatenate(points)


def limb_axis(model: LimbModel) -> tuple[float, float, float]:
    """Direction of the limb's long axis in the site's frame, within the skin's plane (unit vector).

    It is derived from the patient's head-foot axis or, if the model has no patient frame, taken across the
    probe's long side.
    """
    axis = patient_from_model(model)[:3, :3].T @ HEAD
    axis[2] = 0.0
    length = float(np.linalg.norm(axis))
    x, y, z = axis / length if length > 1e-6 else (0.0, 1.0, 0.0)
    return float(x), float(y), float(z)


def fibre_direction(model: LimbModel) -> Value:
    """Direction of the muscle fibres: that of the case, cell by cell where it varies; else `limb_axis`."""
    given = model.fibres
    if given is None:
        return limb_axis(model)
    first = given.values[0]
    if np.array_equal(given.values, np.broadcast_to(first, given.values.shape)):
        return float(first[0]), float(first[1]), float(first[2])
    return given


def thickness(model: LimbModel) -> float:
    """Distance from skin to bone along the beam (mm): depth of the nearest bone facet below the origin; NaN
    if none."""
    surface = model.mesh.surfaces.get("bone")
    if surface is None:
        nodes = model.mesh.node_sets.get("fixed")
        return float("nan") if nodes is None or not len(nodes) else float(-model.mesh.points[nodes, 2].min())
    corners = np.concatenate([np.zeros((0, 3), np.int64), *(each[:, :3] for each in surface.facets.values())])
    a, b, c = model.mesh.points[corners.T]
    (x1, y1, z1), (x2, y2, z2), (x, y, _) = (b - a).T, (c - a).T, -a.T
    det = x1 * y2 - y1 * x2
    seen = np.abs(det) > 1e-12
    safe = np.where(seen, det, 1.0)
    s, t = (x * y2 - y * x2) / safe, (x1 * y - y1 * x) / safe
    z = a[:, 2] + s * z1 + t * z2
    hit = seen & (s >= 0) & (t >= 0) & (s + t <= 1) & (z < 0)
    return float(-z[hit].max()) if hit.any() else float("nan")
