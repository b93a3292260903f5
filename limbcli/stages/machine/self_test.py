"""A small indentation with a closed-form solution, to verify that a solver works on this machine.

A block of ten-node tetrahedra on a fixed base, its sides constrained laterally, is compressed by a plate that
covers its whole top: every point is in uniaxial strain, J = l, and the force is the area times the nominal
stress

    P(l) = c/(2 m) (l^(m-1) - l^(-m-1)) + kappa' (l - 1)

where l is the stretch along the load (the derivative of the Ogden-type energy; Ogden, Non-linear Elastic
Deformations, 1984, section 7.2).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from limbcli.files.temporary_folders import scratch_folder
from limbcli.materials import ogden_type
from limbcli.meshing.regions import facets, quadratic
from limbcli.model import (
    Array,
    Block,
    Curve,
    Domain,
    IntArray,
    LimbModel,
    LogRecord,
    Mesh,
    Step,
    Support,
    Surface,
)
from limbcli.model.bodies import Contact, Drive, RigidBody
from limbcli.progress import SILENT, Progress
from limbcli.solvers.solver import Solver

SIDE, HEIGHT, DEPTH = 8.0, 6.0, 2.0  # mm
C, F_KAPPA, M = 0.008, 5.0, 4.0  # MPa, 1, 1
TOLERANCE = 2e-3  # relative error of the force; FEBio stops at a relative displacement change of 1e-3
_INSIDE = 0.05  # mm, initial penetration of the plate, so that it is in contact from the start
_SIX = ((0, 4, 6, 7), (0, 2, 3, 7), (0, 1, 5, 7), (0, 5, 4, 7), (0, 6, 2, 7), (0, 3, 1, 7))


@dataclass(frozen=True)
class SelfTest:
    """The result: the probe's force (N), the expected force (N), and the time (s)."""

    solver: str
    version: str
    force: float
    expected: float
    seconds: float

    @property
    def error_fraction(self) -> float:
        return abs(self.force / self.expected - 1.0)

    @property
    def passed(self) -> bool:
        return bool(self.error_fraction < TOLERANCE)


def self_test(solver: Solver, *, progress: Progress = SILENT) -> SelfTest:
    """Write, run and read the indentation with a solver, and compare it with the closed-form solution.

    Raises LimbError if the solver cannot be started or ends without a result.
    """
    began = time.monotonic()
    with scratch_folder() as folder:
        feb = solver.write(indentation(), folder)
        solver.run(feb, progress=progress, time_limit_s=120.0)
        found = solver.read(feb)
    squeezed = float(np.mean(found.nodes["top.csv"].column("uz")[-1]))
    expected = -(SIDE**2) * nominal_stress(1.0 + squeezed / HEIGHT)
    return SelfTest(
        solver.name, found.version, float(found.probe_force()[-1]), expected, time.monotonic() - began
    )


def nominal_stress(stretch: float) -> float:
    """First Piola-Kirchhoff stress along the load in uniaxial strain, MPa.

    >>> round(nominal_stress(1.0), 12), nominal_stress(0.9) < 0
    (0.0, True)
    """
    return C / (2 * M) * (stretch ** (M - 1) - stretch ** (-M - 1)) + F_KAPPA * C * (stretch - 1)


def indentation(n: int = 2) -> LimbModel:
    """The model: 8 x 8 x 6 mm, compressed by 2 mm; n cubes of six tetrahedra along each edge."""
    points, cells, top = _block(n)
    flat = {axis: np.flatnonzero(_on(points[:, k], (0.0, SIDE))) for k, axis in enumerate("xy")}
    base, face = (np.flatnonzero(_on(points[:, 2], (z,))) for z in (-HEIGHT, 0.0))
    first, over = len(points), 2.0
    plate = np.array([[x, y, -_INSIDE] for x in (-over, SIDE + over) for y in (-over, SIDE + over)])
    quad = np.array([[first, first + 1, first + 3, first + 2]])
    mesh = Mesh(
        np.concatenate([points, plate]),
        (Block("tissue", "tet10", cells), Block("probe", "quad4", quad)),
        {"base": base, "top": face, "x": flat["x"], "y": flat["y"]},
        {"contact": Surface("contact", {"tri6": top}), "face": Surface("face", {"quad4": quad})},
    )
    return LimbModel(
        mesh,
        {"tissue": ogden_type(c=C, f_kappa=F_KAPPA, m=M)},
        (Domain("tissue", "tissue"),),
        bodies=(RigidBody("probe", (SIDE / 2, SIDE / 2, -_INSIDE), ("probe",)),),
        supports=(Support("base", ("z",)), Support("x", ("x",)), Support("y", ("y",))),
        drives=(
            *(Drive("probe", dof, "fixed") for dof in ("x", "y", "u", "v", "w")),  # type: ignore[arg-type]
            Drive("probe", "z", "displacement", _INSIDE - DEPTH, "ramp"),
        ),
        contacts=(Contact("contact", "face", search_radius=5.0),),
        curves={"ramp": Curve(((0.0, 0.0), (1.0, 1.0)))},
        steps=(Step(n_steps=10, step_size=0.1, must_points=(1.0,)),),
        records=(
            LogRecord("rigid_body", ("z", "Fz"), "probe.csv", "probe"),
            LogRecord("node", ("uz",), "top.csv", face),
        ),
    )


def _block(n: int) -> tuple[Array, IntArray, IntArray]:
    """Points, tet10 cells and the top's tri6 facets (normals up) of the block, its top at z = 0."""
    axes = (np.linspace(0, SIDE, n + 1), np.linspace(0, SIDE, n + 1), np.linspace(-HEIGHT, 0, n + 1))
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    number = np.arange(corners[..., 0].size).reshape(corners.shape[:3])
    windows = [number[i : n + i, j : n + j, k : n + k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    tets = np.stack(windows, axis=-1).reshape(-1, 8)[:, np.array(_SIX)].reshape(-1, 4)
    points, cells, middle = quadratic(corners.reshape(-1, 3), tets)
    top = number[:, :, -1]
    a, b, c, d = (top[i : n + i, j : n + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return points, cells, facets(faces, middle)["tri6"]


def _on(values: Array, places: tuple[float, ...]) -> np.ndarray:
    return np.isin(values, places)
