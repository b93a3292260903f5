"""The penalty of a contact, as FEBio's `auto_penalty` sets it.

The penalty of a facet is eps = penalty x E x A / V, evaluated once in the reference configuration: E is the
stiffness of the law along the facet's normal (see `materials.stress.penalty_modulus`), A the facet's area,
V the volume of the cell behind it. The normal is that where both natural coordinates are 0: the middle of a
quadrilateral, but the first corner of a triangle, which matters if it is curved.

Source: FEBio 4.11, FEContactInterface::AutoPenalty.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.fem.contacts.patch import Patch
from limbcli.fem.elements.groups import Group
from limbcli.materials.program import CurveAt
from limbcli.materials.stress import penalty_modulus, tangent_change, tangents_at_rest
from limbcli.model import Array
from limbcli.model.bodies import Contact


def penalties(
    contact: Contact, patch: Patch, groups: Sequence[Group], curve: CurveAt, dt: float = 1.0
) -> Array:
    """Penalties eps (n_facets,) of a patch, MPa/mm.

    dt : first time step (s), at which the stiffness of a viscoelastic law is evaluated
    """
    eps = np.full(len(patch.facets), float(contact.penalty))
    if contact.auto_penalty:
        for k, group in enumerate(groups):
            mine = patch.group == k
            if mine.any():
                program = group.material.program(len(group.cells), curve)
                CC = tangents_at_rest(program, patch.cell[mine])
                E = penalty_modulus(CC, patch.normals[mine]) * _stiffening(group, dt)
                eps[mine] *= E * patch.ratio[mine]
    return eps


def _stiffening(group: Group, dt: float) -> float:
    """Ratio of a Prony series' tangent in a step of length dt to that of its elastic law."""
    if group.material.prony is None:
        return 1.0
    g0, terms = group.material.prony
    return g0 + sum(g * -np.expm1(-dt / t) * t / dt for g, t in terms)


def penalty_derivative(
    contact: Contact,
    patch: Patch,
    groups: Sequence[Group],
    number: int,
    curve: CurveAt,
    change: Array,
    dt: float = 1.0,
) -> Array:
    """d eps/d theta (n_facets,), where `change` is d(par)/d(theta) of the law in group `number`."""
    out = np.zeros(len(patch.facets))
    mine = patch.group == number
    if not (contact.auto_penalty and mine.any()):
        return out
    group, cells, n = groups[number], patch.cell[mine], patch.normals[mine]
    base = group.material.program(len(group.cells), curve)
    C0 = tangents_at_rest(base, cells)
    par, dpar = (each if len(each) == 1 else each[cells] for each in (base.par, change))
    F = np.repeat(np.eye(3)[None], len(cells), axis=0)
    C1 = tangent_change(base.ops, par, F, np.zeros_like(F), dpar)
    size = 1e-4 * np.abs(C0).max() / max(np.abs(C1).max(), 1e-300)
    # E is smooth in C: a five-point difference is exact to round-off
    e = [penalty_modulus(C0 + k * size * C1, n) for k in (-2, -1, 1, 2)]
    total = (e[0] - 8 * e[1] + 8 * e[2] - e[3]) / (12 * size)
    out[mine] = contact.penalty * patch.ratio[mine] * total * _stiffening(group, dt)
    return out
