"""A thick tube in a tight rigid tube, as hexahedra; plane strain unless pushed along its axis."""

from __future__ import annotations

import numpy as np

from limbcli.materials import ogden_type
from limbcli.model import Block, Curve, Domain, LimbModel, Mesh, Step, Support, Surface
from limbcli.model.bodies import Contact, Drive, RigidBody

INNER, OUTER, LENGTH = 10.0, 20.0, 10.0  # mm
# The penalty grows by equal ratios: each step then takes up a similar part of the interference.
_GROWTH = tuple((k / 8.0, 10.0 ** (-4.0 + k / 2.0)) for k in range(9))


def tube(
    interference: float,
    *,
    n: tuple[int, int, int] = (6, 32, 2),
    f_kappa: float = 2.0,
    friction: float = 0.0,
    penalty: float = 2000.0,
) -> LimbModel:
    """The tube's inner wall is free; the rigid tube's radius is smaller by `interference` (mm).

    n : cells along the radius, around, and along the axis
    """
    nr, nt, nz = n
    radius = np.linspace(INNER, OUTER, nr + 1)
    angle = np.linspace(0.0, 2 * np.pi, nt, endpoint=False)
    z = np.linspace(0.0, LENGTH, nz + 1)
    R, T, Z = np.meshgrid(radius, angle, z, indexing="ij")
    points = np.stack([R * np.cos(T), R * np.sin(T), Z], axis=-1).reshape(-1, 3)

    def number(i: int, j: int, k: int) -> int:
        return (i * nt + j % nt) * (nz + 1) + k

    cells = np.array(
        [
            [number(i + a, j + b, k + c) for a, b, c in
             ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))]
            for i in range(nr) for j in range(nt) for k in range(nz)
        ]
    )  # fmt: skip
    skin = np.array(
        [[number(nr, j, k), number(nr, j + 1, k), number(nr, j + 1, k + 1), number(nr, j, k + 1)]
         for j in range(nt) for k in range(nz)]
    )  # fmt: skip
    tight, n_rigid = OUTER - interference, nt  # facet opposite facet: chords are compared with chords
    around = np.linspace(0.0, 2 * np.pi, n_rigid, endpoint=False)
    rim = np.stack([tight * np.cos(around), tight * np.sin(around)], axis=1)
    wall = np.concatenate([np.c_[rim, np.full(n_rigid, h)] for h in (-LENGTH, 2 * LENGTH)])
    first, k = len(points), np.arange(n_rigid)
    following = (k + 1) % n_rigid
    facets = first + np.stack([k, k + n_rigid, following + n_rigid, following], axis=1)  # normals inward
    flat = np.flatnonzero((points[:, 2] < 1e-9) | (points[:, 2] > LENGTH - 1e-9))
    mesh = Mesh(
        np.concatenate([points, wall]),
        (Block("tissue", "hex8", cells), Block("socket", "quad4", facets)),
        {
            "ends": flat,
            "x_axis": np.flatnonzero(abs(points[:, 1]) < 1e-9),
            "y_axis": np.flatnonzero(abs(points[:, 0]) < 1e-9),
            "bone": np.flatnonzero(np.hypot(points[:, 0], points[:, 1]) < INNER + 1e-9),
        },
        {"skin": Surface("skin", {"quad4": skin}), "inner_face": Surface("inner_face", {"quad4": facets})},
    )
    return LimbModel(
        mesh,
        {"tissue": ogden_type(c=0.02, f_kappa=f_kappa, m=2.0)},
        (Domain("tissue", "tissue"),),
        bodies=(RigidBody("socket", (0.0, 0.0, 0.0), ("socket",)),),
        supports=(Support("ends", ("z",)), Support("x_axis", ("y",)), Support("y_axis", ("x",))),
        drives=tuple(Drive("socket", dof, "fixed") for dof in ("x", "y", "z", "u", "v", "w")),
        contacts=(
            Contact("skin", "inner_face", name="donning", penalty=penalty, search_radius=5.0,
                    friction=friction, symmetric=not friction, penalty_curve="donning"),
        ),
        curves={"donning": Curve(_GROWTH)},
        steps=(Step(n_steps=8, step_size=0.125, must_points=(1.0,)),),
    )  # fmt: skip


def lame_pressure(interference: float, mu: float, lame: float) -> float:
    """Pressure (MPa) on the outer wall of the free tube whose outer radius is reduced: plane strain.

    u = A r + B / r with no traction on the inner wall. Source: Timoshenko and Goodier, Theory of
    Elasticity, 3rd edition, section 28.
    """
    # sigma_rr = 2 (lame + mu) A - 2 mu B / r^2, and it vanishes at INNER
    ratio = (lame + mu) * INNER**2 / mu  # B / A
    A = -interference / (OUTER + ratio / OUTER)
    return -(2 * (lame + mu) * A - 2 * mu * ratio * A / OUTER**2)
