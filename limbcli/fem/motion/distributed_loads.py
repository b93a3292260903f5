"""Loads on the tissue: pressure, traction and forces on surfaces, body forces, nodal forces.

Forces are consistent with the shape functions. A pressure, or a traction on the deformed surface, follows the
deformation; its tangent is symmetric only if the surface is closed or held at its rim.

Source: FEBio 4.11, FEPressureLoad, FETractionLoad, FESurfaceForceUniform, FENodalForce,
FEElasticSolidDomain::BodyForce.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from limbcli.errors import SolveError
from limbcli.fem.elements.element import shape
from limbcli.fem.elements.groups import Group
from limbcli.fem.elements.quadrature import rule
from limbcli.fem.motion.rigid import Body, skew
from limbcli.model import Array, IntArray, LimbModel, Load
from limbcli.numbers.math_expressions import Formula


@dataclass(eq=False)
class LoadedSurface:
    """The facets (n_facets, n_nodes) of one kind to which a load applies.

    N (n_gauss, n_nodes), dN (n_gauss, n_nodes, 2), weights (n_gauss,) : shape functions and integration rule
    amount (n_facets or 1, n_gauss or 1, n_components) : the load's value
    pairs : of its nodes in the matrix pattern (see `Pattern`)
    """

    load: Load
    facets: IntArray
    N: Array
    dN: Array
    weights: Array
    amount: Array
    pairs: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int32))

    def at(self, X: Array, time: float) -> None:
        """Evaluate the load's value at a time, at the integration points of the undeformed facets."""
        self.amount = _amount(self.load, np.einsum("gk,fki->fgi", self.N, X[self.facets]), time)

    @property
    def follows(self) -> bool:
        return not self.load.on_reference

    def forces(self, x: Array) -> Array:
        """Forces (n_facets, n_nodes, 3) at unit load factor, for node positions x."""
        g1, g2 = self._tangents(x)
        return self._spread(self._stress(np.cross(g1, g2)))

    def change(self, x: Array, v: Array) -> Array:
        """Change of `forces` for velocities v."""
        g1, g2 = self._tangents(x)
        d1, d2 = self._tangents(v)
        dn = np.cross(d1, g2) + np.cross(g1, d2)
        if self.load.kind == "pressure":
            return self._spread(-self.amount * dn)
        n = np.cross(g1, g2)
        dA = (n * dn).sum(axis=-1) / np.linalg.norm(n, axis=-1)
        return self._spread(dA[..., None] * self.amount)

    def blocks(self, x: Array) -> Array:
        """Derivatives (n_facets, n_nodes, 3, n_nodes, 3) of `forces` by the positions of the nodes."""
        g1, g2 = (_skews(each) for each in self._tangents(x))
        # the change of n = g1 x g2 with a node's position
        dn = np.einsum("gb,fgij->fgbij", self.dN[..., 1], g1) - np.einsum(
            "gb,fgij->fgbij", self.dN[..., 0], g2
        )
        if self.load.kind == "pressure":
            dt = -self.amount[:, :, None, None] * dn
        else:
            n = np.cross(*self._tangents(x))
            unit = n / np.linalg.norm(n, axis=-1, keepdims=True)
            stress = np.broadcast_to(self.amount, unit.shape)
            dt = np.einsum("fgi,fgk,fgbkj->fgbij", stress, unit, dn)
        return np.einsum("g,ga,fgbij->faibj", self.weights, self.N, dt)

    def area(self, x: Array) -> float:
        n = np.cross(*self._tangents(x))
        return float((np.linalg.norm(n, axis=-1) @ self.weights).sum())

    def _tangents(self, x: Array) -> tuple[Array, Array]:
        """Tangent vectors (n_facets, n_gauss, 3)."""
        g = np.einsum("fki,gkd->dfgi", x[self.facets], self.dN)
        return g[0], g[1]

    def _stress(self, n: Array) -> Array:
        """Force per unit natural area for area vectors n."""
        if self.load.kind == "pressure":
            return -self.amount * n
        return np.linalg.norm(n, axis=-1, keepdims=True) * self.amount

    def _spread(self, t: Array) -> Array:
        return np.einsum("g,ga,fgi->fai", self.weights, self.N, t)


class DistributedLoads:
    """All loads on tissue of one analysis step.

    surfaces : the facets under pressure and traction, by load and kind of facet
    """

    def __init__(
        self,
        model: LimbModel,
        loads: Sequence[Load],
        groups: Sequence[Group],
        bodies: Sequence[Body],
        X: Array,
    ):
        self.X = X
        self._model, self._groups = model, groups
        self.surfaces = [each for load in loads for each in _surfaces(model, load, X)]
        self._factors: dict[int, float] = {}
        # forces (n_points, 3) per load factor that do not depend on the deformation
        self._dead = [(load, _dead(model, load, groups, X, 0.0)) for load in loads if not _on_surface(load)]
        for surface in self.surfaces:
            surface.at(X, 0.0)
            if surface.load.on_reference:
                self._dead.append((surface.load, _sum(surface, surface.forces(X), X)))
        self._moving = [load for load in loads if _changes(load)]
        self._following = [each for each in self.surfaces if each.follows]
        # refuse loads on nodes that belong to rigid bodies only
        for load in loads:
            at = [each.facets.ravel() for each in self.surfaces if each.load is load]
            if load.kind == "nodal force":
                at.append(model.mesh.node_sets[load.on])
            else:
                at += [np.flatnonzero(force.any(axis=1)) for each, force in self._dead if each is load]
            nodes = np.unique(np.concatenate(at)) if at else np.zeros(0, dtype=np.int64)
            for body in bodies:
                if len(np.intersect1d(nodes, np.setdiff1d(body.points, body.tied))):
                    raise SolveError(
                        f"a {load.kind} on {load.on!r}, which belongs to the rigid body {body.name!r}, is "
                        "not supported",
                        where="loads",
                        fix="apply a rigid force or moment to the body",
                    )
        self._refuse_bodies_mass(model, loads)

    def at(self, curve: Callable[[str], float], time: float) -> None:
        """Evaluate the load factors, and formulas, at the time (s) of `curve`."""
        if self._moving:
            self._evaluate(time)
        loads = [load for load, _ in self._dead] + [each.load for each in self.surfaces]
        self._factors = {id(each): 1.0 if each.curve is None else curve(each.curve) for each in loads}

    def _evaluate(self, time: float) -> None:
        for surface in self.surfaces:
            if _changes(surface.load):
                surface.at(self.X, time)
        on_reference = iter([each for each in self.surfaces if each.load.on_reference])
        for k, (load, _) in enumerate(self._dead):
            surface_ = next(on_reference) if _on_surface(load) else None
            if not _changes(load):
                continue
            if surface_ is None:
                self._dead[k] = load, _dead(self._model, load, self._groups, self.X, time)
            else:
                self._dead[k] = load, _sum(surface_, surface_.forces(self.X), self.X)

    def forces(self, u: Array) -> Array:
        """Nodal forces (n_points, 3) of all loads at displacements u."""
        out = np.zeros_like(self.X)
        for load, force in self._dead:
            out += self._factors[id(load)] * force
        for each in self._following:
            out += self._factors[id(each.load)] * _sum(each, each.forces(self.X + u), self.X)
        return out

    def change(self, u: Array, v: Array) -> Array:
        """Change of `forces` for velocities v (n_points, 3)."""
        out = np.zeros_like(self.X)
        for each in self._active:
            out += self._factors[id(each.load)] * _sum(each, each.change(self.X + u, v), self.X)
        return out

    def subtract_symmetric(self, u: Array, blocks: Array) -> None:
        """Subtract the symmetric part of the loads' derivative from the blocks of all node pairs."""
        for each in self._active:
            K = self._factors[id(each.load)] * each.blocks(self.X + u)
            K = 0.5 * (K + K.transpose(0, 3, 4, 1, 2))
            place = 0
            for b in range(K.shape[1]):
                for a in range(b + 1):
                    pair, swapped = each.pairs[:, place] // 2, each.pairs[:, place] % 2 == 1
                    place += 1
                    one = K[:, a, :, b, :]
                    np.subtract.at(
                        blocks, pair, np.where(swapped[:, None, None], one.transpose(0, 2, 1), one)
                    )

    def unsymmetric(self, u: Array) -> sparse.csr_array | None:
        """Minus the antisymmetric part of the loads' derivative (3 n_points, 3 n_points), if there is one."""
        total: sparse.csr_array | None = None
        for each in self._active:
            K = self._factors[id(each.load)] * each.blocks(self.X + u)
            size = K.shape[1] * 3
            rows = (3 * each.facets[:, :, None] + np.arange(3)).reshape(-1, size)
            i, j = np.broadcast_arrays(rows[:, :, None], rows[:, None, :])
            half = 0.5 * (K.transpose(0, 3, 4, 1, 2) - K).reshape(-1, size, size)
            shape_of = (self.X.size, self.X.size)
            part = sparse.coo_array((half.ravel(), (i.ravel(), j.ravel())), shape=shape_of).tocsr()
            total = part if total is None else total + part
        return total

    @property
    def _active(self) -> list[LoadedSurface]:
        return [each for each in self._following if self._factors[id(each.load)] != 0.0]

    @staticmethod
    def _refuse_bodies_mass(model: LimbModel, loads: Sequence[Load]) -> None:
        """Refuse a body force on rigid bodies with a volume, whose weight it would change."""
        solid = {name for body in model.bodies for name in body.blocks if model.mesh.block(name).is_solid}
        for load in loads:
            if load.kind == "body force" and solid and (not load.on or load.on in solid):
                raise SolveError(
                    f"a body force on the rigid part {min(solid)!r} is not supported",
                    where="loads",
                    fix="apply the body force to the deformable parts, and a force to the rigid body",
                )


def _on_surface(load: Load) -> bool:
    return load.kind in ("pressure", "traction", "surface force")


def _changes(load: Load) -> bool:
    """Whether a formula of time is in it."""
    return any(isinstance(each, Formula) and "t" in each.names for each in load.value)


def _amount(load: Load, points: Array, time: float) -> Array:
    """A load's value at points (..., 3) and a time: (..., n_components), or one for all points."""
    if not any(isinstance(each, Formula) for each in load.value):
        return np.array(load.value, dtype=float).reshape((1,) * (points.ndim - 1) + (-1,))
    parts = [
        each(points, time) if isinstance(each, Formula) else np.full(points.shape[:-1], each)
        for each in load.value
    ]
    return np.stack(parts, axis=-1)


def _sum(surface: LoadedSurface, forces: Array, X: Array) -> Array:
    out = np.zeros_like(X)
    np.add.at(out, surface.facets, forces)
    return out


def _skews(vectors: Array) -> Array:
    """Matrices (..., 3, 3) of the cross products with vectors (..., 3)."""
    return np.einsum("...k,kij->...ij", vectors, np.stack([skew(axis) for axis in np.eye(3)]))


def _surfaces(model: LimbModel, load: Load, X: Array) -> list[LoadedSurface]:
    if not _on_surface(load):
        return []
    known = model.mesh.surfaces
    if load.on not in known:
        raise SolveError(
            f"a {load.kind} refers to the unknown surface {load.on!r}",
            where="loads",
            fix=f"use one of {sorted(known)}",
        )
    found = []
    for kind, facets in known[load.on].facets.items():
        points, weights = rule(kind)
        on = np.asarray(facets, dtype=np.int64)
        found.append(LoadedSurface(load, on, *shape(kind, points), weights, np.zeros((1, 1, 1))))
    if load.kind == "surface force":
        area = sum(each.area(X) for each in found)
        if not area > 0:
            raise SolveError(
                f"the surface {load.on!r} under a force has no area", where="loads", fix="give it facets"
            )
        for each in found:
            each.weights = each.weights / area
    return found


def _dead(model: LimbModel, load: Load, groups: Sequence[Group], X: Array, time: float) -> Array:
    """Forces (n_points, 3) at unit load factor of a body force or of forces on nodes."""
    out = np.zeros_like(X)
    if load.kind == "nodal force":
        if load.on not in model.mesh.node_sets:
            raise SolveError(
                f"a nodal force refers to the unknown node set {load.on!r}",
                where="loads",
                fix=f"use one of {sorted(model.mesh.node_sets)}",
            )
        nodes = model.mesh.node_sets[load.on]
        np.add.at(out, nodes, _amount(load, X[nodes], time))
        return out
    mine = [group for group in groups if load.on in ("", group.block)]
    if not mine:
        raise SolveError(
            f"a body force refers to {load.on!r}, which is no part of the tissue",
            where="loads",
            fix=f"use one of {[group.block for group in groups]}",
        )
    density = {domain.block: model.materials[domain.material].density for domain in model.domains}
    for group in mine:
        if group.material.prestrain is not None:
            raise SolveError(
                f"a body force on the prestrained part {group.block!r} is not supported",
                where="loads",
                fix="run this model with FEBio",
            )
        N = shape(group.kind, group.points)[0]
        amount = _amount(load, np.einsum("gn,cni->cgi", N, X[group.cells]), time)
        amount = np.broadcast_to(amount, (*group.weight.shape, 3))
        forces = np.einsum("cg,gn,cgi->cni", group.weight, N, amount)
        np.add.at(out, group.cells, density[group.block] * forces)
    return out
