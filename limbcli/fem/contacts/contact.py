"""Builds the contact pairs of a model: patches of soft facets against facets of a rigid body or of tissue."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.errors import SolveError
from limbcli.fem.contacts.facet_tree import FacetTree
from limbcli.fem.contacts.friction import FrictionPair
from limbcli.fem.contacts.pairs import Pair, rim_widths
from limbcli.fem.contacts.patch import Patch
from limbcli.fem.elements.element import shape
from limbcli.fem.elements.groups import Group
from limbcli.fem.elements.quadrature import rule
from limbcli.fem.motion.rigid import Body
from limbcli.model import Array, IntArray, LimbModel, Surface
from limbcli.model.bodies import Contact

_CORNERS = {"tri3": 3, "tri6": 3, "quad4": 4}


def make_pairs(model: LimbModel, groups: Sequence[Group], bodies: Sequence[Body]) -> list[Pair]:
    """The contact pairs of a model; raises SolveError for unsupported contacts and settings."""
    pairs: list[Pair] = []
    for contact in model.contacts:
        _refuse(contact)
        secondary = _surface(model, contact.secondary)
        primary = _surface(model, contact.primary)
        facets2 = _secondary_side(secondary, contact)
        body = _body_of(facets2, groups, bodies, contact)
        patches = [_patch(model, kind, facets, groups, contact) for kind, facets in primary.facets.items()]
        points = np.ascontiguousarray(model.mesh.points, dtype=float)
        # with friction no fading at the rim: traction that fades along a slip is a negative stiffness, with
        # which a limb pressed against the brim of its socket found no equilibrium
        sharp = np.zeros((len(facets2), 4))
        rim = sharp if contact.friction else rim_widths(points, facets2, patches)
        tree = FacetTree.of(points, facets2)
        if contact.friction or body is None:  # between soft surfaces also with a coefficient of 0
            pairs.append(FrictionPair(contact, facets2, patches, rim, tree, body, points))
        else:
            pairs.append(Pair(contact, facets2, patches, rim, tree, body, points))
    return pairs


def _surface(model: LimbModel, name: str) -> Surface:
    if name not in model.mesh.surfaces:
        raise SolveError(
            f"there is no surface {name!r}", where="contact", fix=f"use one of {sorted(model.mesh.surfaces)}"
        )
    return model.mesh.surfaces[name]


# Settings that may be switched on: FEBio's search options, fluid options, and those used by `Pair.augment`.
_TAKEN = {"seg_up", "minaug", "maxaug", "ptol", "pressure_penalty", "contact_frac"}


def _refuse(contact: Contact) -> None:
    wrong = ""
    if contact.two_pass:
        wrong = "two_pass"
    elif contact.update_penalty:
        wrong = "update_penalty"
    taken = _TAKEN if contact.augmented else {*_TAKEN, "smooth_aug"}
    for tag, value in contact.more.items():
        on = str(value).strip() not in ("", "0", "0.0", "false")
        if on and tag not in taken:
            wrong = tag
    if wrong:
        raise SolveError(
            f"<{wrong}> of contact {contact.name!r} is not supported by the reference solver",
            where=f"contact {contact.name!r}",
            fix=f"switch {wrong} off, or run FEBio",
        )


def _secondary_side(surface: Surface, contact: Contact) -> IntArray:
    """The nodes of its facets, see `contact_points`."""
    width = 6 if "tri6" in surface.facets else 4
    parts = [np.zeros((0, width), dtype=np.int64)]
    for kind, facets in surface.facets.items():
        if kind not in ("tri3", "quad4", "tri6"):
            raise SolveError(
                f"{kind} facets on the secondary side are not supported",
                where=f"contact {contact.name!r}",
                fix="use tri3, quad4 or tri6 facets",
            )
        full = np.full((len(facets), width), -1, dtype=np.int64)
        full[:, : facets.shape[1]] = facets
        parts.append(full)
    return np.concatenate(parts)


def _body_of(
    facets2: IntArray, groups: Sequence[Group], bodies: Sequence[Body], contact: Contact
) -> int | None:
    """Number of the rigid body that the secondary side is part of; None if it is part of the tissue."""
    used = np.unique(facets2[facets2 >= 0])
    for k, body in enumerate(bodies):
        if len(used) and np.isin(used, body.points).all():
            return k
    soft = np.concatenate([np.zeros(0, dtype=np.int64), *(group.cells.ravel() for group in groups)])
    if len(used) and np.isin(used, soft).all():
        return None
    raise SolveError(
        f"the secondary surface {contact.secondary!r} is part neither of one rigid body nor of the tissue",
        where=f"contact {contact.name!r}",
        fix="make its facets those of one rigid body, or faces of the tissue's cells",
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
    # as FEBio's automatic penalty does: in a curved triangle, that of its first corner
    first, second = np.moveaxis(np.einsum("fni,nd->fdi", X, shape(kind, np.zeros((1, 2)))[1][0]), 1, 0)
    normals = np.cross(first, second)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    group, cell = _cells_behind(facets[:, : _CORNERS[kind]], groups, contact)
    volume = np.empty(len(facets))
    for k, each in enumerate(groups):
        mine = group == k
        volume[mine] = each.weight[cell[mine]].sum(axis=1)
    return Patch(
        facets, N, dN, weights, group, cell, area, area / volume, normals,
        np.zeros(len(facets)), np.zeros((len(facets), len(weights))),
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


def near_nodes(X: Array, rigid: IntArray, soft: IntArray, normals: Array) -> IntArray:
    """Nodes of the facets `soft` whose centroid lies under the facets `rigid`, seen along the mean normal.

    "Under" means inside their bounding rectangle along their principal axes; a larger root front costs more
    than it gains. This only sizes the front; contact itself is searched on all facets.

    X (n_points, 3) : reference positions
    rigid (n, 4) : nodes; the last is -1 in a triangle
    """
    if not len(rigid) or not len(soft):
        return np.zeros(0, dtype=np.int64)
    mean = normals.mean(axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-12)
    flat = np.eye(3) - np.outer(mean, mean)
    outline = X[np.unique(rigid[rigid >= 0])] @ flat
    middle = outline.mean(axis=0)
    axes = np.linalg.svd(outline - middle, full_matrices=False)[2][:2]
    along = (outline - middle) @ axes.T
    at = (X[soft[:, :3]].mean(axis=1) @ flat - middle) @ axes.T
    inside = ((at >= along.min(axis=0)) & (at <= along.max(axis=0))).all(axis=1)
    return np.unique(soft[inside])
