"""Cells with a constant pressure: FEBio's three-field element, for uncoupled laws in hexahedra and wedges.

The pressure of a cell is p = U'(theta) with U = k/2 (ln theta)^2, where theta = v/V is the ratio of its
volume to the initial one; the deviatoric stress belongs to each integration point. With dilatation and
pressure eliminated, the tangent has the term U''(theta)/V b (x) b, where b = dv/du.

Source: Simo and Taylor (1991), Comput. Methods Appl. Mech. Eng. 85, 273-310; FEBio Theory Manual 4,
"Three-Field Element".
"""

from __future__ import annotations

import numpy as np

from limbcli.fem.elements.groups import Operands
from limbcli.fem.elements.kernels import _cofactor, _gather, _gradient
from limbcli.model import Array
from limbcli.numbers.compiled import njit


def _positive_ratios(o: Operands, J: Array) -> Array:
    """theta (n_cells,) from the volume ratios J (n_cells, n_gauss); 1 in inverted cells."""
    theta = (o.weight * J).sum(axis=1) / o.weight.sum(axis=1)
    return np.where(theta > 0, theta, 1.0)


def _pressure_per_bulk(o: Operands, J: Array) -> Array:
    theta = _positive_ratios(o, J)
    return np.asarray(np.log(theta) / theta)


def pressures(o: Operands, J: Array) -> Array:
    """Mean stress U'(theta) (n_cells,), positive in tension, MPa; 0 in inverted cells."""
    assert o.bulk is not None
    return np.asarray(o.bulk * _pressure_per_bulk(o, J))


def equivalent_volumes(o: Operands, J: Array) -> Array:
    """Volume ratios (n_cells, n_gauss) that exceed J by p/k.

    With Lame's lambda = k, the element loops for independent volume ratios then apply the pressure p.
    """
    return np.asarray(J + _pressure_per_bulk(o, J)[:, None])


def stiffnesses(o: Operands, J: Array) -> Array:
    """U''(theta)/V (n_cells,), MPa/mm3."""
    assert o.bulk is not None
    theta = _positive_ratios(o, J)
    return np.asarray(o.bulk * (1.0 - np.log(theta)) / theta**2 / o.weight.sum(axis=1))


def volume_gradients(o: Operands, u: Array) -> Array:
    """b = dv/du (n_cells, n_nodes, 3), mm2, at displacements u (n_points, 3)."""
    out = np.zeros((*o.cells.shape, 3))
    _volume_gradients(u, o.cells, o.grad, o.weight, o.base, out)
    return out


@njit
def _volume_gradients(u, cells, grad, weight, base, out):  # type: ignore[no-untyped-def]
    F, B = np.empty((3, 3)), np.empty((3, 3))
    own = np.empty((cells.shape[1], 3))
    for e in range(cells.shape[0]):
        _gather(u, cells[e], own)
        for g in range(weight.shape[1]):
            _gradient(own, grad[e, g], base, F)
            _cofactor(F, B)
            for a in range(cells.shape[1]):
                for i in range(3):
                    value = 0.0
                    for j in range(3):
                        value += B[i, j] * grad[e, g, a, j]
                    out[e, a, i] += weight[e, g] * value


@njit
def add_stiffness(factors, b, pairs, blocks):  # type: ignore[no-untyped-def]
    """blocks (n_pairs, 3, 3) += factor b (x) b of every cell; pairs as in `assembly.Pattern`."""
    n_nodes = b.shape[1]
    for e in range(b.shape[0]):
        k = 0
        for high in range(n_nodes):
            for low in range(high + 1):
                pair, swapped = pairs[e, k] // 2, pairs[e, k] % 2
                k += 1
                first, second = (high, low) if swapped else (low, high)
                for i in range(3):
                    for j in range(3):
                        blocks[pair, i, j] += factors[e] * b[e, first, i] * b[e, second, j]
