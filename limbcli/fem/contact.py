"""Contact of the soft skin with the rigid probe: FEBio's frictionless `sliding-elastic` law.

The penalty of a facet is eps = penalty x E x A / V (auto_penalty), taken at the
reference state and kept: E the stiffness of the law along the facet's normal (see
`materials.stress.penalty_modulus`), A the facet's area, V the volume of the cell behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem import contact_kernels as kernels
from limbcli.fem.element import shape
from limbcli.fem.groups import Group
from limbcli.fem.quadrature import rule
from limbcli.fem.rigid import Body
from limbcli.materials.program import CurveAt, Program
from limbcli.materials.stress import _evaluate, penalty_modulus
from limbcli.model import Array, Contact, IntArray, LimbModel, Surface

_CORNERS = {"tri3": 3, "tri6": 3, "quad4": 4}


@dataclass(eq=False)
class Patch:
    """Soft facets of one kind with their integration points.

    group, cell : the group of cells behind each facet, and the cell's row in it
    ratio : area over volume behind (1/mm); normals : of the reference state
    """

    facets: IntArray
    N: Array
    dN: Array
    weights: Array
    group: IntArray
    cell: IntArray
    ratio: Array
    normals: Array
    eps: Array
    multiplier: Array
    state: Array
    pairs: IntArray = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int64))


Carried = Sequence[Array]


@dataclass(eq=False)
class Pair:
    """One contact of the model: soft patches against the facets of a body."""

    contact: Contact
    body: int
    facets2: IntArray
    patches: list[Patch]

    def search(self, x: Array) -> int:
        """Refresh the state of all points at current places x (n_points, 3); how many touch."""
        spheres, box = _bounds(x, self.facets2)
        c = self.contact
        return sum(
            kernels.search(
                0, len(p.facets), x, p.facets, p.N, p.dN, x, self.facets2, spheres, box,
                c.search_radius, c.search_tolerance, p.eps, p.multiplier, p.state,
            )
            for p in self.patches
        )  # fmt: skip

    def force(self, center: Array, out: Array, body: Array) -> None:
        for p in self.patches:
            kernels.force(p.facets, p.N, p.weights, p.state, center, out, body)

    def times(
        self, x: Array, center: Array, v: Array, motion: Array, carried: Carried, out: Array, body: Array
    ) -> None:
        for p, t in zip(self.patches, carried, strict=True):
            kernels.times(x, p.facets, p.N, p.dN, p.weights, p.eps, p.state, t, center, v, motion, out, body)

    def stiffness(self, x: Array, carried: Carried, slots: IntArray, values: Array) -> None:
        for p, t in zip(self.patches, carried, strict=True):
            kernels.stiffness(x, p.facets, p.N, p.dN, p.weights, p.eps, p.state, t, p.pairs, slots, values)

    def linear_tractions(self, x: Array, v: Array, motion: Array, carried: Carried) -> list[Array]:
        """Tractions (n_facets, n_gauss) of each patch, changed linearly along v and the body's motion."""
        out = []
        for p, t in zip(self.patches, carried, strict=True):
            out.append(np.empty(p.state.shape[:2]))
            kernels.linear_tractions(x, p.facets, p.N, p.dN, p.eps, p.state, t, v, motion, out[-1])
        return out

    def shifted_force(self, carried: Carried, out: Array) -> None:
        """Add what tractions `carried` instead of the contact's own change in the nodal forces."""
        for p, t in zip(self.patches, carried, strict=True):
            kernels.shifted_force(p.facets, p.N, p.weights, p.state, t, out)

    def set_penalty(self, groups: Sequence[Group], curve: CurveAt, dt: float) -> None:
        for p in self.patches:
            p.eps = penalties(self.contact, p, groups, curve, dt)

    def forget(self) -> None:
        """As before any load: no facet touched, no multiplier."""
        for p in self.patches:
            p.state[:] = 0.0
            p.state[..., kernels.FACET] = -1
            p.multiplier[:] = 0.0

    def augment(self) -> float:
        """Take the tractions over as multipliers; the relative change of their sum of squares."""
        before = sum(float((p.multiplier**2).sum()) for p in self.patches)
        for p in self.patches:
            p.multiplier = p.state[..., kernels.TRACTION].copy()
        after = sum(float((p.multiplier**2).sum()) for p in self.patches)
        return abs(after - before) / after if after else 0.0


def _bounds(x: Array, facets2: IntArray) -> tuple[Array, Array]:
    corners = x[np.where(facets2 < 0, facets2[:, :1], facets2)]
    center = corners.mean(axis=1)
    reach = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1) * 1.05
    box = np.stack([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])
    return np.concatenate([center, reach[:, None]], axis=1), box


def make_pairs(model: LimbModel, groups: Sequence[Group], bodies: Sequence[Body]) -> list[Pair]:
    """The model's contacts; whatever cannot be computed is refused."""
    pairs = []
    for contact in model.contacts:
        _refuse(contact)
        secondary = _surface(model, contact.secondary)
        primary = _surface(model, contact.primary)
        body, facets2 = _rigid_side(secondary, bodies, contact)
        patches = [_patch(model, kind, facets, groups, contact) for kind, facets in primary.facets.items()]
        pairs.append(Pair(contact, body, facets2, patches))
    return pairs


def _surface(model: LimbModel, name: str) -> Surface:
    if name not in model.mesh.surfaces:
        raise SolveError(
            f"there is no surface {name!r}", where="contact", fix=f"use one of {sorted(model.mesh.surfaces)}"
        )
    return model.mesh.surfaces[name]


_IGNORED = {
    "seg_up",
    "minaug",
    "maxaug",
    "smooth_aug",
    "ptol",
    "pressure_penalty",
    "contact_frac",
    "node_reloc",
}


def _refuse(contact: Contact) -> None:
    wrong = ""
    if contact.two_pass:
        wrong = "two_pass"
    elif contact.update_penalty:
        wrong = "update_penalty"
    elif contact.friction:
        wrong = "fric_coeff"
    for tag, value in contact.more.items():
        on = str(value).strip() not in ("", "0", "0.0", "false")
        if on and tag not in _IGNORED:
            wrong = tag
    if wrong:
        raise SolveError(
            f"<{wrong}> of contact {contact.name!r} is not supported by the reference solver",
            where=f"contact {contact.name!r}",
            fix=f"switch {wrong} off, or run FEBio",
        )


def _rigid_side(surface: Surface, bodies: Sequence[Body], contact: Contact) -> tuple[int, IntArray]:
    parts = []
    for kind, facets in surface.facets.items():
        if kind not in ("tri3", "quad4"):
            raise SolveError(
                f"{kind} facets on the rigid side are not supported",
                where=f"contact {contact.name!r}",
                fix="use tri3 or quad4 facets for the probe",
            )
        full = np.full((len(facets), 4), -1, dtype=np.int64)
        full[:, : facets.shape[1]] = facets
        parts.append(full)
    facets2 = np.concatenate(parts) if parts else np.zeros((0, 4), dtype=np.int64)
    used = np.unique(facets2[facets2 >= 0])
    for k, body in enumerate(bodies):
        if len(used) and np.isin(used, body.points).all():
            return k, facets2
    raise SolveError(
        f"the secondary surface {contact.secondary!r} is not part of one rigid body",
        where=f"contact {contact.name!r}",
        fix="make the probe a rigid body and the skin the primary surface",
    )


def _patch(model: LimbModel, kind: str, facets: IntArray, groups: Sequence[Group], contact: Contact) -> Patch:
    if kind not in _CORNERS:
        raise SolveError(
            f"{kind} facets are not supported", where=f"contact {contact.name!r}", fix="use tri3"
        )
    points, weights = rule(kind)
    N, dN = shape(kind, points)
    facets = np.ascontiguousarray(facets, dtype=np.int64)
    X = model.mesh.points[facets]
    tangents = np.einsum("fni,gnd->fgdi", X, dN)
    area_vectors = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    area = np.linalg.norm(area_vectors, axis=2) @ weights
    normals = np.einsum("fgi,g->fi", area_vectors, weights)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    group, cell = _cells_behind(facets[:, : _CORNERS[kind]], groups, contact)
    volume = np.empty(len(facets))
    for k, each in enumerate(groups):
        mine = group == k
        volume[mine] = each.weight[cell[mine]].sum(axis=1)
    shape_of_state = (len(facets), len(weights))
    state = np.zeros((*shape_of_state, kernels.N_STATE))
    state[..., kernels.FACET] = -1
    return Patch(
        facets, N, dN, weights, group, cell, area / volume, normals,
        np.zeros(len(facets)), np.zeros(shape_of_state), state,
    )  # fmt: skip


def _cells_behind(corners: IntArray, groups: Sequence[Group], contact: Contact) -> tuple[IntArray, IntArray]:
    group = np.full(len(corners), -1, dtype=np.int64)
    cell = np.full(len(corners), -1, dtype=np.int64)
    for k, each in enumerate(groups):
        touching: dict[int, set[int]] = {}
        for row in np.flatnonzero(np.isin(each.cells, corners).any(axis=1)):
            for node in each.cells[row]:
                touching.setdefault(int(node), set()).add(int(row))
        for f, nodes in enumerate(corners):
            if group[f] < 0:
                found = set.intersection(*(touching.get(int(n), set()) for n in nodes))
                if found:
                    group[f], cell[f] = k, min(found)
    if (group < 0).any():
        raise SolveError(
            f"{int((group < 0).sum())} facets of {contact.primary!r} have no cell behind them",
            where=f"contact {contact.name!r}",
            fix="the primary surface must be faces of the tissue's cells",
        )
    return group, cell


def penalties(
    contact: Contact, patch: Patch, groups: Sequence[Group], curve: CurveAt, dt: float = 1.0
) -> Array:
    """eps (n_facets,) of a patch, MPa/mm. dt : first step (s): a viscoelastic law is as stiff as in it."""
    eps = np.full(len(patch.facets), contact.penalty)
    if contact.auto_penalty:
        for k, group in enumerate(groups):
            mine = patch.group == k
            if mine.any():
                program = group.material.program(len(group.cells), curve)
                E = _moduli(program, patch.cell[mine], patch.normals[mine]) * _stiffening(group, dt)
                eps[mine] *= E * patch.ratio[mine]
    return eps


def _stiffening(group: Group, dt: float) -> float:
    """Tangent of a Prony series over its elastic law's, in a step of length dt."""
    if group.material.prony is None:
        return 1.0
    g0, terms = group.material.prony
    return g0 + sum(g * -np.expm1(-dt / t) * t / dt for g, t in terms)


def _moduli(program: Program, cells: IntArray, normals: Array) -> Array:
    par = program.par if len(program.par) == 1 else program.par[cells]
    F = np.repeat(np.eye(3)[None], len(cells), axis=0)
    S, CC = np.zeros((len(cells), 6)), np.zeros((len(cells), 6, 6))
    _evaluate(F, program.ops, par, S, CC, True)
    return penalty_modulus(CC, normals)


def penalty_derivative(
    contact: Contact,
    patch: Patch,
    groups: Sequence[Group],
    number: int,
    curve: CurveAt,
    programs: list[Program],
) -> Array:
    """d eps/d theta (n_facets,), where the law of group `number` changes as `programs` say.

    At F = 1 the tangent does not depend on exponents, so only the linear programs count.
    """
    out = np.zeros(len(patch.facets))
    mine = patch.group == number
    if not (contact.auto_penalty and mine.any()):
        return out
    group, cells, n = groups[number], patch.cell[mine], patch.normals[mine]
    base = group.material.program(len(group.cells), curve)
    h = 1e-4
    total = np.zeros(int(mine.sum()))
    C0 = _identity_tangent(base, cells)
    for program in programs:
        if program.ops[0, 0] > 100:
            continue
        C1 = _identity_tangent(program, cells)
        size = h * np.abs(C0).max() / max(np.abs(C1).max(), 1e-300)
        # E is smooth in C: a five-point difference is exact to round-off
        e = [penalty_modulus(C0 + k * size * C1, n) for k in (-2, -1, 1, 2)]
        total += (e[0] - 8 * e[1] + 8 * e[2] - e[3]) / (12 * size)
    out[mine] = contact.penalty * patch.ratio[mine] * total
    return out


def _identity_tangent(program: Program, cells: IntArray) -> Array:
    par = program.par if len(program.par) == 1 else program.par[cells]
    F = np.repeat(np.eye(3)[None], len(cells), axis=0)
    S, CC = np.zeros((len(cells), 6)), np.zeros((len(cells), 6, 6))
    _evaluate(F, program.ops, par, S, CC, True)
    return CC
