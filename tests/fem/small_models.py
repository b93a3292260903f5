"""Small blocks, with or without a rigid plate that presses on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.fem.elements.element import _TET10_EDGES
from limbcli.materials import ogden_type
from limbcli.model import Block, Curve, Domain, LimbModel, Material, Mesh, Step, Support, Surface
from limbcli.model.bodies import Contact, Drive, RigidBody

_SIX = ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6))
_TWO_WEDGES = ((0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7))


def grid(n: tuple[int, int, int], size: tuple[float, float, float], twist: float = 0.0):
    """Points and hex8 cells of a block [0, size] with its top at z = 0; inner points moved by `twist`."""
    axes = [np.linspace(0, s, k + 1) for s, k in zip(size, n, strict=True)]
    X = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    if twist:
        rng = np.random.default_rng(7)
        X[1:-1, 1:-1, 1:-1] += twist * rng.uniform(-1, 1, X[1:-1, 1:-1, 1:-1].shape)
    number = np.arange(X[..., 0].size).reshape(X.shape[:3])
    c = [number[i : i + n[0], j : j + n[1], k : k + n[2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    order = [0, 4, 6, 2, 1, 5, 7, 3]
    cells = np.stack([c[k] for k in order], axis=-1).reshape(-1, 8)
    points = X.reshape(-1, 3)
    points[:, 2] -= size[2]
    return points, cells


def cells_of(kind: str, points: np.ndarray, hexes: np.ndarray):
    """(points, cells) of a kind made from hexahedra."""
    if kind == "hex8":
        return points, hexes
    if kind == "penta6":
        return points, hexes[:, np.array(_TWO_WEDGES)].reshape(-1, 6)
    tets = hexes[:, np.array(_SIX)].reshape(-1, 4)
    if kind == "tet4":
        return points, tets
    edges = tets[:, np.array(_TET10_EDGES)]
    flat = np.sort(edges.reshape(-1, 2), axis=1)
    unique, inverse = np.unique(flat, axis=0, return_inverse=True)
    middle = 0.5 * (points[unique[:, 0]] + points[unique[:, 1]])
    numbers = len(points) + inverse.reshape(len(tets), 6)
    return np.concatenate([points, middle]), np.concatenate([tets, numbers], axis=1)


def on(points: np.ndarray, axis: int, value: float) -> np.ndarray:
    return np.flatnonzero(abs(points[:, axis] - value) < 1e-9)


def block(
    kind: str = "tet4",
    n: tuple[int, int, int] = (2, 2, 2),
    size: tuple[float, float, float] = (1.0, 1.0, 1.0),
    *,
    material: Material | None = None,
    twist: float = 0.0,
) -> LimbModel:
    """A block of one material without supports; node sets x0 x1 y0 y1 z0 (bottom) z1 (top) and `all`."""
    points, cells = cells_of(kind, *grid(n, size, twist))
    sets = {
        f"{axis}{side}": on(points, k, value)
        for k, axis in enumerate("xyz")
        for side, value in enumerate((0, size[k]) if k < 2 else (-size[2], 0))
    }
    sets["all"] = np.arange(len(points))
    outer = np.unique(np.concatenate([sets[k] for k in ("x0", "x1", "y0", "y1", "z0", "z1")]))
    mesh = Mesh(points, (Block("tissue", kind, cells),), {**sets, "outer": outer})
    return LimbModel(
        mesh,
        {"tissue": material or ogden_type(c=0.005, f_kappa=5.0, m=2.0)},
        (Domain("tissue", "tissue"),),
        curves={"ramp": Curve(((0.0, 0.0), (1.0, 1.0)))},
        steps=(Step(n_steps=1, step_size=1.0),),
    )


def top_facets(model: LimbModel) -> dict[str, np.ndarray]:
    """Facets of the cells that lie in the top plane, normals upward."""
    top = set(model.mesh.node_sets["z1"].tolist())
    faces = {
        "tet4": ("tri3", ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))),
        "tet10": (
            "tri6",
            ((0, 2, 1, 6, 5, 4), (0, 1, 3, 4, 8, 7), (1, 2, 3, 5, 9, 8), (0, 3, 2, 7, 9, 6)),
        ),
        "hex8": ("quad4", ((4, 5, 6, 7),)),
    }
    tissue = model.mesh.block("tissue")
    kind, local = faces[tissue.kind]
    found = [c[list(f)] for c in tissue.cells for f in local if all(int(k) in top for k in c[list(f)])]
    return {kind: np.array(found, dtype=np.int64)}


def punch(
    kind: str = "tet4",
    n: tuple[int, int, int] = (4, 3, 3),
    *,
    depth: float = 1.0,
    levels: int = 2,
    material: Material | None = None,
    width: float = 16.0,
    drives: tuple[Drive, ...] | None = None,
) -> LimbModel:
    """A block 12 x 10 x 8 mm on a held base, pressed by a flat plate, 0.05 mm inside at first."""
    model = block(kind, n, (12.0, 10.0, 8.0), material=material)
    start = 0.05
    side = np.array([-0.5, 0.5]) * width
    corners = np.array([(6.0 + x, 5.0 + y, -start) for y in side for x in side])
    first = len(model.mesh.points)
    plate = Block("probe", "quad4", np.array([[first, first + 2, first + 3, first + 1]]))
    mesh = Mesh(
        np.concatenate([model.mesh.points, corners]),
        (*model.mesh.blocks, plate),
        model.mesh.node_sets,
        {"contact": Surface("contact", top_facets(model)), "face": Surface("face", {"quad4": plate.cells})},
    )
    if drives is None:
        drives = (
            *(Drive("probe", dof, "fixed") for dof in ("x", "y", "u", "v", "w")),
            Drive("probe", "z", "displacement", start - depth, "ramp"),
        )
    return LimbModel(
        mesh,
        model.materials,
        model.domains,
        bodies=(RigidBody("probe", (6.0, 5.0, -start), ("probe",)),),
        supports=(Support("z0", ("x", "y", "z")),),
        drives=drives,
        contacts=(Contact("contact", "face", penalty=20.0, search_radius=5.0),),
        curves=model.curves,
        steps=(
            Step(
                n_steps=10,
                step_size=0.1,
                must_points=tuple((k + 1) / levels for k in range(levels - 1)) or (1.0,),
            ),
        ),
    )


def under_a_rigid_half(kind: str) -> LimbModel:
    """A block whose upper half is rigid and pressed down by 0.1 mm; node set `middle` between the halves."""
    model = block(kind, (1, 1, 4))
    points, cells = model.mesh.points, model.mesh.block("tissue").cells
    upper = points[cells, 2].mean(axis=1) > -0.5
    blocks = (Block("tissue", kind, cells[~upper]), Block("plate", kind, cells[upper]))
    return replace(
        model,
        mesh=Mesh(points, blocks, {**model.mesh.node_sets, "middle": on(points, 2, -0.5)}),
        bodies=(RigidBody("plate", (0.5, 0.5, 0.0), ("plate",)),),
        supports=(Support("z0", ("x", "y", "z")),),
        drives=(
            *(Drive("plate", dof, "fixed") for dof in ("x", "y", "u", "v", "w")),
            Drive("plate", "z", "displacement", -0.1, "ramp"),
        ),
    )
