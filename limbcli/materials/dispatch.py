"""One compiled entry for every law: `second_piola` adds up the leaves of a program.

A program is `ops` (n_leaves, 3) int64, each row (law, offset of its numbers in the
parameter row, extra), with one row of numbers `par` per cell (or one for all). Sums
of laws (mixtures) are several rows. Laws above 100 are derivatives of a law with
respect to one of its numbers, so that dR/dp is the internal-force kernel itself.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from limbcli.materials.fiber import add_contraction, add_fiber, add_fiber_derivative
from limbcli.materials.holmes_mow import add_holmes_mow, add_holmes_mow_derivative
from limbcli.materials.neo_hooke import add_neo_hooke
from limbcli.materials.ogden import (
    add_ogden,
    add_ogden_exponent_derivative,
    add_ogden_squares,
    add_uncoupled,
    add_uncoupled_exponent_derivative,
    all_squares,
)
from limbcli.materials.tensors import determinant, eigen6, right_cauchy_green

OGDEN, UNCOUPLED, NEO_HOOKE, HOLMES_MOW, FIBER, CONTRACTION = 1, 2, 3, 4, 5, 6
OGDEN_DM, UNCOUPLED_DM, HOLMES_MOW_D, FIBER_D = 101, 102, 104, 105


@njit(cache=True)
def workspace():
    """Scratch for `second_piola`: C, inverse, B (6 each), squares, logs, tau, d (3 each), vectors, a."""
    return np.zeros((3, 6)), np.zeros((4, 3)), np.zeros((3, 3)), np.zeros((3, 3))


@njit(cache=True)
def second_piola(F, ops, par, S, CC, tangent, work):
    """S (6) and, if `tangent`, CC (6, 6) of the program at F. Returns det F; below or at 0 nothing is set."""
    six, three, vectors, a = work
    C = six[0]
    squares, logs, tau, d = three[0], three[1], three[2], three[3]
    J = determinant(F)
    S[:] = 0.0
    if tangent:
        CC[:, :] = 0.0
    if J <= 0.0:
        return J
    right_cauchy_green(F, C)
    spectral = False
    for leaf in range(ops.shape[0]):
        law, off, extra = ops[leaf, 0], ops[leaf, 1], ops[leaf, 2]
        if law == OGDEN and all_squares(par, off, extra):
            add_ogden_squares(par, off, extra, J, C, six[1], six[2], S, CC, tangent)
            continue
        if not spectral and law in (OGDEN, UNCOUPLED, OGDEN_DM, UNCOUPLED_DM):
            eigen6(C, squares, vectors)
            for i in range(3):
                logs[i] = 0.5 * np.log(squares[i])
            spectral = True
        if law == OGDEN:
            add_ogden(par, off, extra, J, squares, logs, vectors, tau, a, d, S, CC, tangent)
        elif law == NEO_HOOKE:
            add_neo_hooke(par, off, J, C, six[1], S, CC, tangent)
        elif law == UNCOUPLED:
            add_uncoupled(par, off, extra, J, squares, logs, vectors, tau, a, d, S, CC, tangent)
        elif law == HOLMES_MOW:
            add_holmes_mow(par, off, J, C, six[1], six[2], S, CC, tangent)
        elif law == FIBER:
            add_fiber(par, off, extra, C, six[1], S, CC, tangent)
        elif law == CONTRACTION:
            add_contraction(par, off, six[1], S)
        elif law == OGDEN_DM:
            add_ogden_exponent_derivative(par, off, extra, squares, logs, vectors, tau, a, d, S, CC)
        elif law == UNCOUPLED_DM:
            add_uncoupled_exponent_derivative(par, off, extra, J, squares, logs, vectors, tau, a, d, S, CC)
        elif law == HOLMES_MOW_D:
            add_holmes_mow_derivative(par, off, extra, J, C, six[1], six[2], S)
        elif law == FIBER_D:
            add_fiber_derivative(par, off, extra, C, six[1], S)
    return J
