"""The indentation model made from a site's mesh: tissue, load, solver settings, records."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import CaseError
from limbcli.feb.settings import LEAST_START, START_DEPTHS, Schedule, robust_contact, robust_step
from limbcli.materials.ogden import ogden_type
from limbcli.model import Array, ElementMap, IntArray, LimbModel, LogRecord, Material
from limbcli.model.bodies import Drive

PROBE, TISSUE, TRAVEL = "probe", "tissue", "probe_travel"
C_KPA = (0.1, 500.0)  # kPa, range of c given by hand; values outside are probably in another unit (8000 Pa)
RIGID_FIELDS = ("x", "y", "z", "thx", "thy", "thz", "Fx", "Fy", "Fz", "Mx", "My", "Mz")
NODE_FIELDS = ("ux", "uy", "uz")
ELEMENT_FIELDS = (
    "J", "sx", "sy", "sz", "sxy", "syz", "sxz",
    "Fxx", "Fxy", "Fxz", "Fyx", "Fyy", "Fyz", "Fzx", "Fzy", "Fzz",
)  # fmt: skip

# mm, region of elements whose deformation is recorded for the shear-wave prediction: the scanner's window
# (12 mm to either side, 25 mm deep, slice thickness 3 mm each way) with a margin for its smoothing and for
# tissue that moves into it.
_SWE_HALF_WIDTH, _SWE_HALF_THICKNESS, _SWE_DEPTH = 20.0, 12.0, 32.0
_FEWEST_TOUCHING = 12
_FLAT = 1e-6
_CONTACT_POINTS = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6


@dataclass(frozen=True)
class TissueLaw:
    """c (MPa), f_kappa and m of a tissue (means, where they vary), their source in words, the sites used."""

    c: float = 0.008
    f_kappa: float = 100.0
    m: float = 2.0
    source: str = "assumed"
    sites: tuple[str, ...] = ()


def indentation_model(model: LimbModel, plan: Schedule, *, c: float, f_kappa: float, m: float) -> LimbModel:
    """The meshed model with tissue, a load through the plan's depths, solver settings and records.

    Raises CaseError if the model has no body `probe`, no contact, or no material `tissue`.
    """
    _check(model)
    model = start_at(model, plan.start).with_material(TISSUE, ogden_type(c=c, f_kappa=f_kappa, m=m))
    others = tuple(each for each in model.drives if (each.body, each.dof) != (PROBE, "z"))
    element = next(each.kind for each in model.mesh.solid_blocks)
    return replace(
        model,
        contacts=tuple(robust_contact(each) for each in model.contacts),
        drives=(*others, Drive(PROBE, "z", "displacement", -1.0, TRAVEL)),
        curves={TRAVEL: plan.curve()},
        steps=(robust_step(plan, element),),
        records=(
            LogRecord("rigid_body", RIGID_FIELDS, "rigid_body.csv", PROBE),
            LogRecord("node", NODE_FIELDS, "nodes.csv", model.mesh.solid_nodes),
            LogRecord("element", ELEMENT_FIELDS, "elements.csv", window_cells(model, plan.depths[-1])),
        ),
    )


def with_tissue(model: LimbModel, *, c: float | ElementMap, f_kappa: float, m: float) -> LimbModel:
    """The model with the Ogden-type law of these parameters for its tissue.

    c : MPa; if a map over the tissue's elements, c1, c2 and kappa become maps
    """
    if not isinstance(c, ElementMap):
        return model.with_material(TISSUE, ogden_type(c=c, f_kappa=f_kappa, m=m))
    law = ogden_type(c=float(c.values.min()), f_kappa=f_kappa, m=m)
    shares = {"c1": 0.5, "c2": 0.5, "kappa": f_kappa}
    maps = {name: ElementMap(f"{TISSUE}_{name}", c.block, share * c.values) for name, share in shares.items()}
    return model.with_material(TISSUE, law.with_parameters(**maps))


def with_penalty(model: LimbModel, penalty: float) -> LimbModel:
    """The model with this penalty in all its contacts."""
    return replace(model, contacts=tuple(replace(each, penalty=penalty) for each in model.contacts))


def _check(model: LimbModel) -> None:
    bodies = {body.name for body in model.bodies}
    if TISSUE not in model.materials or PROBE not in bodies or not model.contacts:
        raise CaseError(
            f"the meshed model lacks {TISSUE!r}, {PROBE!r} or their contact",
            where="model.npz",
            fix="mesh again",
        )


def starting_depth(model: LimbModel, first_level: float) -> float:
    """Initial penetration of the probe (mm) at which at least a dozen contact points touch.

    Without contact, the first iteration of a solver has no force by which to judge convergence. Counted are
    the contact points (three per facet) of the skin under the flat of the probe. If even the largest
    initial depth touches too few, it is used nevertheless. If it touches none (coarse facets cut off the
    crest that the probe meets first), the probe starts at the first contact point, but never deeper than half
    of the first level.
    """
    _check(model)
    allowed = [each for each in START_DEPTHS if each <= first_level / 2] or [LEAST_START]
    for depth in allowed:
        if touching_points(start_at(model, depth)) >= _FEWEST_TOUCHING:
            return depth
    if touching_points(start_at(model, allowed[-1])):
        return allowed[-1]
    beyond = 0.05 * np.ceil(facet_gap(model) / 0.05 + 1)
    return float(round(beyond, 2)) if beyond <= first_level / 2 else allowed[-1]


def touched_first(model: LimbModel) -> tuple[IntArray, Array]:
    """The skin's highest contact point under the flat of the probe, as facet corners and their weights."""
    corners, points, under = _under_flat(model)
    highest = int(np.argmax(np.where(under, points[:, 2], -np.inf)))
    facet, point = divmod(highest, len(_CONTACT_POINTS))
    return corners[facet], _CONTACT_POINTS[point]


def facet_gap(model: LimbModel) -> float:
    """Depth (mm) at which the flat of the probe meets the first contact point of the skin; NaN if none.

    First touch is at the true skin; the facets of a curved skin lie below it by their sagitta.
    """
    heights = _heights_under_flat(model)
    return float(-heights.max()) if len(heights) else float("nan")


def touching_points(model: LimbModel) -> int:
    """Number of the skin's contact points above the flat of the probe's face, within its outline."""
    return int((_heights_under_flat(model) > _flat(model)[:, 2].min()).sum())


def _flat(model: LimbModel) -> Array:
    """Nodes (n, 3) of the flat of the probe's face."""
    body = next(each for each in model.bodies if each.name == PROBE)
    probe = model.mesh.points[model.mesh.nodes_of(body.blocks)]
    return np.asarray(probe[probe[:, 2] < probe[:, 2].min() + _FLAT])


def _heights_under_flat(model: LimbModel) -> Array:
    """Heights z (n,) of the skin's contact points within the outline of the flat."""
    _, points, under = _under_flat(model)
    return np.asarray(points[under, 2])


def _under_flat(model: LimbModel) -> tuple[IntArray, Array, NDArray[np.bool_]]:
    """Corners of the skin's facets (n, 3), their contact points (3 n, 3), and which lie under the flat."""
    flat = _flat(model)
    facets = model.mesh.surfaces[model.contacts[0].primary].facets.values()
    corners = np.concatenate([each[:, :3] for each in facets])
    points = np.einsum("qi,nij->nqj", _CONTACT_POINTS, model.mesh.points[corners]).reshape(-1, 3)
    under = (points[:, :2] >= flat[:, :2].min(axis=0)) & (points[:, :2] <= flat[:, :2].max(axis=0))
    return corners, points, under.all(axis=1)


def start_at(model: LimbModel, depth: float) -> LimbModel:
    """The model with its probe moved along z so that the face starts `depth` mm below first touch."""
    body = next(each for each in model.bodies if each.name == PROBE)
    x, y, z = body.center_of_mass
    points: Array = model.mesh.points.copy()
    points[model.mesh.nodes_of(body.blocks), 2] += -depth - z
    moved = replace(body, center_of_mass=(x, y, -depth))
    bodies = tuple(moved if each.name == PROBE else each for each in model.bodies)
    return replace(model, mesh=replace(model.mesh, points=points), bodies=bodies)


def window_cells(model: LimbModel, deepest: float) -> IntArray:
    """Tissue cells (numbered over all blocks) that may enter the shear-wave window; all if none does.

    Cells of layers are excluded: speeds are read and predicted in the tissue only.
    """
    of_tissue = {each.block for each in model.domains if each.material == TISSUE}
    found, every, first = [], [], 0
    for block in model.mesh.blocks:
        if block.name in of_tissue:
            x, y, z = np.abs(model.mesh.points[block.cells].mean(axis=1)).T
            near = (x <= _SWE_HALF_WIDTH) & (y <= _SWE_HALF_THICKNESS) & (z <= _SWE_DEPTH + deepest)
            found.append(first + np.flatnonzero(near))
            every.append(first + np.arange(len(block.cells)))
        first += len(block.cells)
    near_cells = np.concatenate(found)
    return near_cells if len(near_cells) else np.concatenate(every)


BAND = 0.05  # width of the transition in I4 over which fibres engage


def softer_jumps(model: LimbModel, band: float = BAND) -> LimbModel:
    """Let sheared fibres engage over a wider band of I4, which converges faster than an abrupt jump."""

    def soften(material: Material) -> Material:
        parts = tuple(map(soften, material.parts))
        if material.law == "fiber_exp_pow" and material.parameters.get("mu"):
            material = material.with_parameters(band=band)
        return replace(material, parts=parts) if parts else material

    return replace(model, materials={name: soften(each) for name, each in model.materials.items()})


def fewer_steps(model: LimbModel, n: int) -> LimbModel:
    """Limit the load steps of a path-dependent model to `n` equal steps.

    These are sufficient. With friction, alternating long and short steps need up to twice the work of equal
    ones.
    """
    steps = tuple(
        replace(each, n_steps=n, step_size=each.n_steps * each.step_size / n, adaptive=False)
        if each.n_steps > n
        else each
        for each in model.steps
    )
    return replace(model, steps=steps)
