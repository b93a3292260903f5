"""A tight sleeve of tetrahedra in both solvers: small enough to find out why facets differ.

    python -m tests.benchmarks.socket_febio_sleeve --work DIR [--tet10] [--friction 0.3]
        [--penetration-mm 0.1] [--slip-as-febio] [--liner bonded|slides] [--febio FILE]

An oval sleeve on a bone, in a rigid one of other facets whose flared brim ends below its upper end: donned in
6 steps, then pushed on with 2 N in 3. A liner is 2 mm thick, of 300 kPa. Prints the rows of `socket_febio`.
--penetration-mm 0: penalty alone.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from limbcli.meshing.regions import facets, quadratic
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array, Block, LimbModel, Support, Surface
from limbcli.sockets.donning import DonningOptions, don_and_load
from limbcli.sockets.liner import LINER, Liner, with_liner
from limbcli.solvers.febio import FebioSolver
from tests.benchmarks.socket_febio import febio, reference, rows, with_records
from tests.fem.tubes import LENGTH, OUTER, tube

LONG, TIGHT, THICK = 3.0 * LENGTH, 0.8, 2.0  # mm
_SIX = np.array([(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)])
_FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def _radius(angle: Array, z: Array) -> Array:
    return (OUTER + 0.1 * (z - 0.5 * LONG)) * (1 + 0.08 * np.cos(2 * angle + 0.3))


def limb(*, tet10: bool) -> LimbModel:
    """The sleeve on its bone, at rest; its skin has no nodes in common with the wall."""
    n = (2, 16, 4) if tet10 else (3, 24, 6)
    model = tube(1.0, n=n, f_kappa=20.0)
    cells = model.mesh.block("tissue").cells
    points = model.mesh.points[: cells.max() + 1].copy()
    radius = np.hypot(points[:, 0], points[:, 1])
    outer = np.isclose(radius, OUTER)
    share = (radius - radius.min()) / np.ptp(radius)
    points[:, 2] *= LONG / LENGTH
    full = _radius(np.arctan2(points[:, 1], points[:, 0]), points[:, 2]) / OUTER
    points[:, :2] *= (1 + share * (full - 1))[:, None]
    tets = cells[:, _SIX].reshape(-1, 4)
    a, b, c = (points[tets[:, k]] - points[tets[:, 0]] for k in (1, 2, 3))
    turned = np.einsum("ij,ij->i", np.cross(a, b), c) < 0
    tets[turned] = tets[turned][:, [0, 2, 1, 3]]
    faces = tets[:, _FACES].reshape(-1, 3)
    _, which, counts = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    skin = faces[(counts[which.ravel()] == 1) & outer[faces].all(axis=1)]
    bone = model.mesh.node_sets["bone"]
    block, middle = Block("tissue", "tet4", tets), None
    if tet10:
        points, tets, middle = quadratic(points, tets)
        block = Block("tissue", "tet10", tets)
        between = [node for ends, node in middle.items() if np.isin(ends, bone).all()]
        bone = np.concatenate([bone, np.array(between, dtype=np.int64)])
    mesh = replace(
        model.mesh, points=points, blocks=(block,), node_sets={"bone": bone},
        surfaces={"skin": Surface("skin", facets(skin, middle))},
    )  # fmt: skip
    supports = (Support("bone", ("x", "y", "z")),)
    return replace(model, mesh=mesh, bodies=(), drives=(), contacts=(), curves={}, supports=supports)


def face(n: int = 37, n_rows: int = 11) -> Triangles:
    """The wall's inner face; it flares over the last fifth of its height."""
    heights = np.linspace(-0.3 * LONG, 0.75 * LONG, n_rows)
    T, Z = np.meshgrid(np.linspace(0.0, 2 * np.pi, n, endpoint=False), heights)
    R = _radius(T, Z) - TIGHT + 1.5 * np.clip((Z / LONG - 0.6) / 0.15, 0.0, 1.0) ** 2
    k = np.arange(n)
    after, faces = (k + 1) % n, []
    for row in range(n_rows - 1):
        a, b = row * n + k, row * n + after
        faces += [np.stack([a, b + n, b], axis=1), np.stack([a, a + n, b + n], axis=1)]
    points = np.stack([R * np.cos(T), R * np.sin(T), Z], axis=-1).reshape(-1, 3)
    return Triangles(points, np.concatenate(faces).astype(np.int64))


def lined(limb: LimbModel, wall: Triangles, how: str | None) -> tuple[LimbModel, Triangles]:
    """With the liner asked for, and the wall as much wider as it is thick."""
    if how is None:
        return limb, wall
    made = Liner(thickness=THICK, youngs_modulus=0.3, poisson=0.45, bonded=how == "bonded")
    radius = np.hypot(wall.points[:, 0], wall.points[:, 1])
    wider = wall.points * np.stack([1 + THICK / radius, 1 + THICK / radius, np.ones(len(radius))], axis=1)
    return with_liner(limb, made), Triangles(wider, wall.faces)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--febio", type=Path)
    parser.add_argument("--tet10", action="store_true")
    parser.add_argument("--friction", type=float, default=0.0)
    parser.add_argument("--penetration-mm", type=float, default=0.1)
    parser.add_argument("--liner", choices=["bonded", "slides"])
    parser.add_argument("--slip-as-febio", action="store_true", help="in the reference solver")
    given = parser.parse_args()
    given.work.mkdir(parents=True, exist_ok=True)
    options = DonningOptions(
        friction=given.friction, loads_n=(2.0,), donning_steps=6, load_steps=3, search_radius_mm=8.0,
        penalty=20.0, penetration_mm=given.penetration_mm or None, slip_as_febio=given.slip_as_febio,
        skin=LINER if given.liner else "skin", liner_slides=given.liner == "slides",
    )  # fmt: skip
    feb = given.work / "socket.feb"
    model, wall = lined(limb(tet10=given.tet10), face(), given.liner)
    with_records(don_and_load(model, wall, options, threads=1).model, feb)
    reference(feb, slip_as_febio=given.slip_as_febio)
    febio(feb, FebioSolver(binary=given.febio).need())
    print("| state | facets | nodes | total | axial force, N |\n|-|-|-|-|-|\n" + "\n".join(rows(feb)))


if __name__ == "__main__":
    main()
