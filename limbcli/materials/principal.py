"""Isotropic laws in principal axes: from Kirchhoff stresses to S and its tangent.

A law provides, for each principal axis i, the Kirchhoff stress tau_i, the matrix
a_ij = d tau_i / d ln(l_j) and the quotients d_ij = (tau_j - tau_i) / (l_j^2 - l_i^2)
(or their limit for equal stretches). Everything else is common to all laws:
S_i = tau_i / l_i^2, the normal block (a_ij - 2 tau_i delta_ij) / (l_i^2 l_j^2) and the
shear terms (d_ij - tau_i / l_i^2) / l_j^2.
"""

from __future__ import annotations

import numpy as np

from limbcli.materials.tensors import FIRST, SECOND, eigen6
from limbcli.numbers.compiled import njit


@njit
def principal_axes(work):
    """Store the principal values of C, half their logarithms (ln l_i) and their directions in the workspace,
    unless another leaf of the program has already done so."""
    squares, logs = work[1][0], work[1][1]
    if squares[0] >= 0.0:
        return
    eigen6(work[0][0], squares, work[2])
    for i in range(3):
        logs[i] = 0.5 * np.log(squares[i])


@njit
def add_principal(squares, vectors, tau, a, d, S, CC, tangent):
    """S += sum S_i r_i r_i and, if `tangent`, CC += its tangent. d : d_01, d_12, d_02

    squares (3) : principal values of C; vectors (3, 3) : their directions in columns
    """
    for i in range(3):
        s = tau[i] / squares[i]
        for p in range(6):
            S[p] += s * vectors[FIRST[p], i] * vectors[SECOND[p], i]
    if not tangent:
        return
    P, H = np.empty((3, 6)), np.empty((3, 6))
    for i in range(3):
        for p in range(6):
            P[i, p] = vectors[FIRST[p], i] * vectors[SECOND[p], i]
    for i in range(3):
        H[i, :] = 0.0
        for j in range(3):
            value = a[i, j]
            if i == j:
                value -= 2.0 * tau[i]
            value /= squares[i] * squares[j]
            for q in range(6):
                H[i, q] += value * P[j, q]
    for p in range(6):
        for q in range(6):
            CC[p, q] += P[0, p] * H[0, q] + P[1, p] * H[1, q] + P[2, p] * H[2, q]
    for pair in range(3):
        i = 1 if pair == 1 else 0
        j = 1 if pair == 0 else 2
        g = (d[pair] - tau[i] / squares[i]) / squares[j]
        for p in range(6):
            k, l = FIRST[p], SECOND[p]
            P[0, p] = vectors[k, i] * vectors[l, j] + vectors[l, i] * vectors[k, j]
        for p in range(6):
            left = g * P[0, p]
            for q in range(6):
                CC[p, q] += left * P[0, q]
