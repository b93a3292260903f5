"""Integration rules by name: natural coordinates and weights, as in FEBio.

Source: FEBio Theory Manual 4.0, section 4.1; the 8-point rule of the tet10 is
Keast's fourth-order rule (Keast 1986, Comput Methods Appl Mech Eng 55:339), with the
ten digits used by FEBio.
"""

from __future__ import annotations

import numpy as np

from limbcli.model import Array


def _tet1() -> tuple[Array, Array]:
    return np.full((1, 3), 0.25), np.array([1.0 / 6.0])


def _tet4() -> tuple[Array, Array]:
    a, b = 0.58541020, 0.13819660
    points = np.full((4, 3), b)
    points[1:] += np.eye(3) * (a - b)
    return points, np.full(4, 0.25 / 6.0)


def _tet8() -> tuple[Array, Array]:
    points = np.concatenate([np.full((4, 3), 0.3280546970), np.full((4, 3), 0.1069522740)])
    points[:3][np.diag_indices(3)] = 0.0158359099
    points[4:7][np.diag_indices(3)] = 0.6791431780
    return points, np.repeat([0.138527967 / 6.0, 0.111472033 / 6.0], 4)


def _hex8() -> tuple[Array, Array]:
    a = 1.0 / np.sqrt(3.0)
    corners = [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)]
    points = np.array(corners + [(r, s, 1) for r, s, _ in corners], dtype=float) * a
    return points, np.ones(8)


def _penta6() -> tuple[Array, Array]:
    a = 1.0 / np.sqrt(3.0)
    plane = [(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)]
    return np.array([(r, s, t) for t in (-a, a) for r, s in plane]), np.full(6, 1.0 / 6.0)


def _tri3() -> tuple[Array, Array]:
    return np.array([(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)]), np.full(3, 1.0 / 6.0)


def _tri7() -> tuple[Array, Array]:
    r5 = np.sqrt(15.0)
    near, far = (6.0 - r5) / 21.0, (6.0 + r5) / 21.0
    points = [(1 / 3, 1 / 3)]
    for a in (near, far):
        points += [(a, a), (1 - 2 * a, a), (a, 1 - 2 * a)]
    weights = [9 / 80] + [(155 - r5) / 2400] * 3 + [(155 + r5) / 2400] * 3
    return np.array(points), np.array(weights)


def _quad4() -> tuple[Array, Array]:
    a = 1.0 / np.sqrt(3.0)
    return np.array([(-a, -a), (a, -a), (a, a), (-a, a)]), np.ones(4)


_RULES = {
    "tet4": _tet1,
    "tet10": _tet8,
    "TET10G4": _tet4,
    "hex8": _hex8,
    "penta6": _penta6,
    "tri3": _tri3,
    "tri6": _tri7,
    "quad4": _quad4,
}


def rule(name: str) -> tuple[Array, Array]:
    """Points (n, 2 or 3) and weights (n,) of a cell kind's default rule, or of a named one.

    The weights add up to the volume of the reference cell:

    >>> round(float(rule("tet10")[1].sum()), 9), round(float(rule("tri6")[1].sum()), 12)
    (0.166666667, 0.5)
    """
    return _RULES[name]()
