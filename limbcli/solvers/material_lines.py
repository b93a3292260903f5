"""Material points on the ultrasound beam below the probe, tracked through a simulation.

The interfaces of skin, fat and muscle are material lines: they are marked in the unloaded mesh at the depths
measured at first touch, and the displacements, interpolated by the elements' shape functions, give their
positions at any other time. Depths are measured from the skin's material point on the beam, so that the
probe's penetration into the skin due to the contact penalty has no effect.

Source: isoparametric interpolation, Zienkiewicz & Taylor, The Finite Element Method, chapter 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.errors import MeasurementError
from limbcli.fem.elements.element import shape
from limbcli.model import Array, IntArray, LimbModel, LogRecord
from limbcli.solvers.solver import Simulation, Table

FILE = "material_lines.csv"
_TETRAHEDRA = ("tet4", "tet10")
_ITERATIONS, _SETTLED = 12, 1e-12  # of Newton's method for natural coordinates: limit; tolerance in mm
_OUTSIDE = 1e-6  # tolerance, in natural coordinates or mm, for points on the boundary of a cell


@dataclass(frozen=True, eq=False)
class MaterialLines:
    """Material lines on the beam (x = y = 0 in the site's frame), and how nodal displacements move them.

    rest (n_lines,) : depth below the skin before loading, mm
    items (n_items,) : nodes whose displacements determine the lines and the skin point
    weights (n_lines, n_items) : interpolation weights, skin minus line, so that the depth below the skin is
        rest + weights @ u_z
    """

    rest: Array
    items: IntArray
    weights: Array

    @property
    def record(self) -> LogRecord:
        """The record that a simulation must write."""
        return LogRecord("node", ("ux", "uy", "uz"), FILE, self.items)

    def below_skin(self, u_z: Array) -> Array:
        """Depths below the skin (..., n_lines), mm, from displacements (..., n_items) of `items` along z."""
        return np.asarray(self.rest + u_z @ self.weights.T)

    def drift(self, u: Array) -> float:
        """Largest lateral offset (mm) of a line from the skin point, for u (n_times, n_items, 3)."""
        moved = np.abs(np.einsum("li,tid->tld", self.weights, u[..., :2]))
        return float(np.linalg.norm(moved, axis=-1).max(initial=0.0))

    def of_table(self, table: Table) -> Array:
        """Displacements (n_times, n_items, 3) of `items`, from a record of at least these nodes.

        Raises MeasurementError if the record lacks some of them.
        """
        place = np.full(max(int(table.items.max(initial=0)), int(self.items.max())) + 1, -1)
        place[table.items] = np.arange(len(table.items))
        if np.any(place[self.items] < 0):
            raise _no_record()
        u = np.stack([table.column(name) for name in ("ux", "uy", "uz")], axis=-1)
        return np.asarray(u[:, place[self.items]])


def displacements(lines: MaterialLines, simulation: Simulation) -> Array:
    """Displacements (n_times, n_items, 3) of the nodes that determine the lines.

    Raises MeasurementError if the simulation did not record them.
    """
    for table in simulation.nodes.values():
        if {"ux", "uy", "uz"} <= set(table.fields):
            return lines.of_table(table)
    raise _no_record()


def material_lines(model: LimbModel, rest: Array) -> MaterialLines:
    """Lines at depths `rest` (n_lines,) mm below the skin of a model in the site's frame.

    NaN stands for the bone surface, which does not move.

    Raises MeasurementError if the beam does not intersect the tissue, a cell is not a tetrahedron, or a line
    lies below the bone.
    """
    column = _Column(model)
    rest = np.asarray(rest, dtype=float)
    top, bottom = column.ends()
    within = rest[np.isfinite(rest)]
    if len(within) and within.max() > top - bottom + _OUTSIDE:
        raise MeasurementError(
            f"an interface was read {within.max():.1f} mm below the skin, but the model's tissue is "
            f"{top - bottom:.1f} mm thick there",
            where="layers on the beam",
            fix="check the layers of level 0 in levels.csv against skin_bone_mm, and the site's position",
        )
    rows = [column.weights(float(z)) for z in (top, *(top - within))]
    items = np.unique(np.concatenate([nodes for nodes, _ in rows]))
    table = np.zeros((len(rows), len(items)))
    for k, (nodes, values) in enumerate(rows):
        np.add.at(table[k], np.searchsorted(items, nodes), values)
    known = np.isfinite(rest)
    weights = np.tile(table[0], (len(rest), 1))
    weights[known] -= table[1:]
    depths = np.where(known, rest, top - bottom)
    return MaterialLines(depths, items, weights)


class _Column:
    """The tetrahedra that the beam may intersect."""

    def __init__(self, model: LimbModel):
        self.points = model.mesh.points
        self.cells: list[tuple[str, IntArray]] = []
        for block in model.mesh.solid_blocks:
            if block.kind not in _TETRAHEDRA:
                raise MeasurementError(
                    f"layers are followed in tetrahedra, not in {block.kind}", where=f"part {block.name!r}",
                    fix="mesh with tet10 elements (the default)",
                )  # fmt: skip
            xy = self.points[block.cells[:, :4], :2]
            near = (xy.min(axis=1) <= _OUTSIDE).all(axis=1) & (xy.max(axis=1) >= -_OUTSIDE).all(axis=1)
            self.cells += [(block.kind, cell) for cell in block.cells[near]]

    def ends(self) -> tuple[float, float]:
        """Heights (mm) of the skin and of the end of the continuous tissue below it (the bone)."""
        spans = sorted(span for kind, cell in self.cells if (span := self._span(cell)) is not None)
        if not spans:
            raise MeasurementError(
                "the beam meets no tissue of the model", where="layers on the beam",
                fix="check the site's position: it should lie on the skin",
            )  # fmt: skip
        top, bottom = spans[-1][1], spans[-1][0]
        for low, high in reversed(spans):
            if high >= bottom - _OUTSIDE:
                bottom = min(bottom, low)
        return top, bottom

    def _span(self, cell: IntArray) -> tuple[float, float] | None:
        """Heights between which the beam lies in a cell with straight edges; None if it misses the cell."""
        at, up = self._affine(cell)
        low, high = -np.inf, np.inf
        for a, b in zip(at, up, strict=True):
            if abs(b) < 1e-14:
                if a < -_OUTSIDE:
                    return None
            elif b > 0:
                low = max(low, -a / b)
            else:
                high = min(high, -a / b)
        return (float(low), float(high)) if high - low > _OUTSIDE else None

    def _affine(self, cell: IntArray) -> tuple[Array, Array]:
        """Coefficients at, up (4,) of the barycentric coordinates at + up z of the point (0, 0, z)."""
        corners = np.vstack([self.points[cell[:4]].T, np.ones(4)])
        solved = np.linalg.solve(corners, np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]))
        return solved[:, 0], solved[:, 1]

    def weights(self, z: float) -> tuple[IntArray, Array]:
        """Nodes, and their interpolation weights at (0, 0, z)."""
        best: tuple[float, IntArray, Array] | None = None
        for kind, cell in self.cells:
            natural = self._natural(kind, cell, z)
            inside = float(min(natural.min(), 1.0 - natural.sum()))
            if best is None or inside > best[0]:
                best = (inside, cell, shape(kind, natural[None])[0][0])
        assert best is not None
        return best[1], best[2]

    def _natural(self, kind: str, cell: IntArray, z: float) -> Array:
        """Natural coordinates (3,) of (0, 0, z), by Newton's method in a tet10."""
        at, up = self._affine(cell)
        natural, X = (at + up * z)[1:], self.points[cell]
        for _ in range(_ITERATIONS if kind == "tet10" else 0):
            N, dN = shape(kind, natural[None])
            off = N[0] @ X - [0.0, 0.0, z]
            if np.abs(off).max() < _SETTLED:
                break
            natural = natural - np.linalg.solve((X.T @ dN[0]), off)
            if not np.isfinite(natural).all() or np.abs(natural).max() > 1e3:
                return (at + up * z)[1:]
        return natural


def _no_record() -> MeasurementError:
    return MeasurementError(
        "the simulation recorded no displacements below the probe",
        where="layers on the beam",
        fix="run it again with limbcli's templates: they request the displacements of all nodes of the "
        "tissue",
    )
