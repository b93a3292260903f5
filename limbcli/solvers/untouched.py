"""Says why a contact had no force in a whole run: which mistake its surfaces look like.

A run in which nothing is touched ends normally, in FEBio too, with a force of exactly 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array, IntArray, LimbModel
from limbcli.model.bodies import Contact, RigidBody
from limbcli.solvers.solver import Table

if TYPE_CHECKING:
    from limbcli.fem.contacts.pairs import Pair
    from limbcli.fem.motion.rigid import BodyState

Poses = Sequence[Mapping[str, "BodyState"]]  # at some times of a run, by the body's name

_MOST_POSES = 8
_WIDE = 10.0  # overlap that is looked for, as a multiple of the search radius, beyond the body's travel


def without_force(model: LimbModel, poses: Poses) -> tuple[str, ...]:
    """A sentence about each contact of a model in which no contact touched anything."""
    return tuple(
        f"nothing was touched: contact {each.name!r} has no force in any step; {_reason(model, each, poses)}"
        for each in model.contacts
    )


def is_without_force(tables: Mapping[str, Table]) -> bool:
    """Whether bodies log forces, and all of these are 0."""
    forces = [table.column(name) for table in tables.values() for name in table.fields if name[0] == "F"]
    return bool(forces) and not any(each.any() for each in forces)


def logged_poses(model: LimbModel, tables: Mapping[str, Table]) -> Poses:
    """The poses that the records of the bodies give; a coordinate that is not logged is as at rest."""
    from limbcli.fem.motion.rigid import BodyState

    centers = {body.name: np.array(body.center_of_mass, dtype=float) for body in model.bodies}
    times = next(table.times for table in tables.values())
    return [
        {
            name: BodyState(
                _row(table, "xyz", k, centers[name]) - centers[name],
                _row(table, ("thx", "thy", "thz"), k, np.zeros(3)),
            )
            for name, table in tables.items()
            if name in centers
        }
        for k in np.flatnonzero(times > 0).tolist()
    ]


def _row(table: Table, names: Sequence[str], k: int, default: Array) -> Array:
    found = [table.column(n)[k, 0] if n in table.fields else d for n, d in zip(names, default, strict=True)]
    return np.array(found, dtype=float)


def _reason(model: LimbModel, contact: Contact, poses: Poses) -> str:
    primary, secondary = (_nodes(model, name) for name in (contact.primary, contact.secondary))
    owner = next((body for body in model.bodies if _is_part(secondary, body, model)), None)
    if owner is None:
        if any(_is_part(primary, body, model) for body in model.bodies):
            return (
                f"its primary surface {contact.primary!r} is the rigid body's: with auto_penalty FEBio may"
                " give no force. Make the soft surface the primary one"
            )
        return "its secondary surface is not a rigid body's, and limbcli searches only those for the reason"
    with suppress(SolveError):
        return _look(model, contact, owner, [pose[owner.name] for pose in poses if owner.name in pose])
    return "limbcli cannot search this kind of contact for the reason"


def _look(model: LimbModel, contact: Contact, body: RigidBody, way: Sequence[BodyState]) -> str:
    """The first mistake whose correction makes the surfaces meet somewhere on the body's way."""
    travel = max((float(np.linalg.norm(each.shift)) for each in way), default=0.0)
    wide = replace(contact, search_radius=travel + _WIDE * contact.search_radius)
    chosen = [way[k] for k in np.unique(np.linspace(0, len(way) - 1, _MOST_POSES).astype(int))] if way else []
    pair, inside_out = _pair(model, wide)
    overlap = max((_overlap(model, pair, body, each) for each in chosen), default=0.0)
    if overlap > 0 and not inside_out:
        found = f"its surfaces overlap by up to {overlap:.3g} mm with the tissue at rest, "
        if overlap > contact.search_radius:
            return f"{found}beyond its search_radius of {contact.search_radius:g} mm: raise it"
        return (
            f"{found}within its search_radius: check that its penalty is above 0, and that the record of "
            f"{body.name!r} holds Fx, Fy and Fz"
        )
    names = [contact.primary] if inside_out else []
    if overlap == 0:
        pair.facets2 = np.ascontiguousarray(_reversed(pair.facets2))
        overlap = max((_overlap(model, pair, body, each) for each in chosen), default=0.0)
        names.append(contact.secondary)
    if overlap > 0:
        return (
            f"the facets of {' and '.join(map(repr, names))} look turned over: normals must point out of "
            "the tissue and out of the body, towards each other"
        )
    return "its surfaces do not meet: the body ends short of the tissue, or passes beside it"


def _pair(model: LimbModel, contact: Contact) -> tuple[Pair, bool]:
    """The contact with a penalty of 1 and its soft facets facing outwards, and whether they faced inwards."""
    from limbcli.fem.contacts.contact import make_pairs
    from limbcli.fem.elements.groups import make_groups
    from limbcli.fem.motion.rigid import make_bodies

    plain, groups = replace(contact, friction=0.0), make_groups(model)
    (pair,) = make_pairs(replace(model, contacts=(plain,)), groups, make_bodies(model, ()))
    pair.rim = np.zeros_like(pair.rim)
    points, outwards = model.mesh.points, []
    for patch in pair.patches:
        patch.eps = np.ones(len(patch.facets))
        behind = [
            points[groups[g].cells[k]].mean(axis=0) for g, k in zip(patch.group, patch.cell, strict=True)
        ]
        away = points[patch.facets].mean(axis=1) - np.array(behind)
        outwards.append((away * patch.normals).sum(axis=1) > 0)
    inside_out = bool(np.concatenate(outwards).mean() < 0.5)
    for patch in pair.patches if inside_out else ():
        patch.facets = np.ascontiguousarray(_reversed(patch.facets))
    return pair, inside_out


def _reversed(facets: IntArray) -> IntArray:
    """Facets (n, 3, 4 or 6) run through the other way; the last node of a triangle among four is -1.

    >>> _reversed(np.array([[0, 1, 2, -1], [0, 1, 2, 3]])).tolist()
    [[0, 2, 1, -1], [0, 3, 2, 1]]
    """
    if facets.shape[1] == 6:
        return facets[:, [0, 2, 1, 5, 4, 3]]
    if facets.shape[1] == 3:
        return facets[:, [0, 2, 1]]
    return np.where(facets[:, 3:] < 0, facets[:, [0, 2, 1, 3]], facets[:, [0, 3, 2, 1]])


def _overlap(model: LimbModel, pair: Pair, body: RigidBody, at: BodyState) -> float:
    """The deepest overlap (mm) of a pair with the body at a pose and the tissue at rest, or 0."""
    from limbcli.fem.contacts.contact_points import GAP, TRACTION

    x = np.array(model.mesh.points, dtype=float)
    own = model.mesh.nodes_of(body.blocks)
    x[own] = at.place(x[own], np.array(body.center_of_mass, dtype=float))
    found = [each[each[..., TRACTION] > 0, GAP] for each in pair.search(x)[0]]
    return float(np.concatenate(found).max(initial=0.0))


def _nodes(model: LimbModel, surface: str) -> IntArray:
    facets = model.mesh.surfaces[surface].facets.values() if surface in model.mesh.surfaces else ()
    return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(each.ravel() for each in facets)]))


def _is_part(nodes: IntArray, body: RigidBody, model: LimbModel) -> bool:
    return bool(len(nodes)) and bool(np.isin(nodes, model.mesh.nodes_of(body.blocks)).all())
