"""Compiled element loops: internal force, tangent, tangent times a vector.

All run over a range of cells and release the interpreter's lock, so that two
threads can share the work. `u` is (n_points, 3); F = base + sum u (x) grad N, where
base is the unit tensor, or the prestrain gradient (with grad N transformed to
match). Stress is scale * S + history, which holds Prony series as well.

One group of cells is (cells, grad, weight, ops, par, base, scale, history): see
`fem.groups.Group`. Each loop returns the smallest det F and the cell it is in.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from limbcli.materials.dispatch import second_piola, workspace
from limbcli.materials.tensors import FIRST, SECOND, VOIGT, inverse6, right_cauchy_green


@njit(cache=True)
def _gradient(u, nodes, grad, base, F):
    for i in range(3):
        for j in range(3):
            F[i, j] = base[i, j]
    for a in range(nodes.shape[0]):
        n = nodes[a]
        for i in range(3):
            ui = u[n, i]
            for j in range(3):
                F[i, j] += ui * grad[a, j]


@njit(cache=True)
def _shift_pressure(F, J, shift, C, D, S, CC):
    """Add a pressure `shift` to S and CC: shift J C^-1 and its derivative."""
    right_cauchy_green(F, C)
    inverse6(C, D)
    for q in range(6):
        S[q] += shift * J * D[q]
        i, j = FIRST[q], SECOND[q]
        for r in range(6):
            k, l = FIRST[r], SECOND[r]
            CC[q, r] += (
                shift * J * (D[q] * D[r] - D[VOIGT[i, k]] * D[VOIGT[j, l]] - D[VOIGT[i, l]] * D[VOIGT[j, k]])
            )


@njit(cache=True)
def _cofactor(F, B):
    """B = J F^-T; returns J."""
    B[0, 0] = F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1]
    B[0, 1] = F[1, 2] * F[2, 0] - F[1, 0] * F[2, 2]
    B[0, 2] = F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0]
    B[1, 0] = F[0, 2] * F[2, 1] - F[0, 1] * F[2, 2]
    B[1, 1] = F[0, 0] * F[2, 2] - F[0, 2] * F[2, 0]
    B[1, 2] = F[0, 1] * F[2, 0] - F[0, 0] * F[2, 1]
    B[2, 0] = F[0, 1] * F[1, 2] - F[0, 2] * F[1, 1]
    B[2, 1] = F[0, 2] * F[1, 0] - F[0, 0] * F[1, 2]
    B[2, 2] = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
    return F[0, 0] * B[0, 0] + F[0, 1] * B[0, 1] + F[0, 2] * B[0, 2]


@njit(cache=True, nogil=True)
def linear_volumes(start, stop, u, v, cells, grad, base, out):
    """out (n_cells, n_gauss) = det F at u plus its linear change along v (n_points, 3)."""
    F, dF, B = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    zero = np.zeros((3, 3))
    for e in range(start, stop):
        for g in range(grad.shape[1]):
            _gradient(u, cells[e], grad[e, g], base, F)
            _gradient(v, cells[e], grad[e, g], zero, dF)
            total = _cofactor(F, B)
            for i in range(3):
                for j in range(3):
                    total += B[i, j] * dF[i, j]
            out[e, g] = total


@njit(cache=True, nogil=True)
def volume_force(start, stop, u, cells, grad, weight, base, lame, volumes, force):
    """force (n_points, 3) += what pressures taken at `volumes` instead of det F add to the internal force."""
    F, B = np.empty((3, 3)), np.empty((3, 3))
    for e in range(start, stop):
        stiffness = lame[e if lame.shape[0] > 1 else 0]
        for g in range(weight.shape[1]):
            _gradient(u, cells[e], grad[e, g], base, F)
            shift = weight[e, g] * stiffness * (volumes[e, g] - _cofactor(F, B))
            for a in range(cells.shape[1]):
                n = cells[e, a]
                for i in range(3):
                    force[n, i] += shift * (
                        B[i, 0] * grad[e, g, a, 0] + B[i, 1] * grad[e, g, a, 1] + B[i, 2] * grad[e, g, a, 2]
                    )


@njit(cache=True)
def _tangent9(F, S, CC, weight, A, T):
    """A[iJ, kL] = weight dP_iJ/dF_kL from S and CC."""
    for i in range(3):
        for j in range(3):
            for q in range(6):
                T[3 * i + j, q] = (
                    F[i, 0] * CC[VOIGT[0, j], q] + F[i, 1] * CC[VOIGT[1, j], q] + F[i, 2] * CC[VOIGT[2, j], q]
                )
    for p in range(9):
        for k in range(3):
            for l in range(3):
                q = 3 * k + l
                if q < p:
                    continue
                value = (
                    T[p, VOIGT[0, l]] * F[k, 0] + T[p, VOIGT[1, l]] * F[k, 1] + T[p, VOIGT[2, l]] * F[k, 2]
                )
                if p // 3 == k:
                    value += S[VOIGT[p % 3, l]]
                A[p, q] = weight * value
                A[q, p] = weight * value


@njit(cache=True, nogil=True)
def internal_force(start, stop, u, cells, grad, weight, ops, par, base, scale, history, force):
    """force (n_points, 3) += integral of P grad N."""
    work = workspace()
    F, S, CC = np.empty((3, 3)), np.empty(6), np.empty((6, 6))
    P = np.empty((3, 3))
    worst, place = 1e300, -1
    has_history = history.shape[0] == cells.shape[0]
    for e in range(start, stop):
        row = e if par.shape[0] > 1 else 0
        for g in range(weight.shape[1]):
            _gradient(u, cells[e], grad[e, g], base, F)
            J = second_piola(F, ops, par[row], S, CC, False, work)
            if worst > J:
                worst, place = J, e
            w = weight[e, g]
            for q in range(6):
                S[q] *= scale
                if has_history:
                    S[q] += history[e, g, q]
            for i in range(3):
                for j in range(3):
                    P[i, j] = w * (
                        F[i, 0] * S[VOIGT[0, j]] + F[i, 1] * S[VOIGT[1, j]] + F[i, 2] * S[VOIGT[2, j]]
                    )
            for a in range(cells.shape[1]):
                n = cells[e, a]
                for i in range(3):
                    force[n, i] += (
                        P[i, 0] * grad[e, g, a, 0] + P[i, 1] * grad[e, g, a, 1] + P[i, 2] * grad[e, g, a, 2]
                    )
    return worst, place


@njit(cache=True, nogil=True)
def tangent_times(
    start, stop, u, cells, grad, weight, ops, par, base, scale, history, lame, volumes, v, force
):
    """force (n_points, 3) += K(u) v; pressures at `volumes` (n_cells, n_gauss), where it has cells."""
    work = workspace()
    F, S, CC = np.empty((3, 3)), np.empty(6), np.empty((6, 6))
    dF, E, dS, P = np.empty((3, 3)), np.empty(6), np.empty(6), np.empty((3, 3))
    zero = np.zeros((3, 3))
    C, D = np.empty(6), np.empty(6)
    has_history = history.shape[0] == cells.shape[0]
    mixed = volumes.shape[0] == cells.shape[0]
    for e in range(start, stop):
        row = e if par.shape[0] > 1 else 0
        for g in range(weight.shape[1]):
            _gradient(u, cells[e], grad[e, g], base, F)
            _gradient(v, cells[e], grad[e, g], zero, dF)
            J = second_piola(F, ops, par[row], S, CC, True, work)
            if mixed:
                stiffness = lame[e if lame.shape[0] > 1 else 0]
                _shift_pressure(F, J, stiffness * (volumes[e, g] - J), C, D, S, CC)
            w = weight[e, g]
            for i in range(3):
                for j in range(i, 3):
                    value = 0.0
                    for k in range(3):
                        value += F[k, i] * dF[k, j] + dF[k, i] * F[k, j]
                    E[VOIGT[i, j]] = 0.5 * value * (1.0 if i == j else 2.0)
            for q in range(6):
                value = 0.0
                for r in range(6):
                    value += CC[q, r] * E[r]
                dS[q] = scale * value
                S[q] *= scale
                if has_history:
                    S[q] += history[e, g, q]
            for i in range(3):
                for j in range(3):
                    value = 0.0
                    for k in range(3):
                        value += F[i, k] * dS[VOIGT[k, j]] + dF[i, k] * S[VOIGT[k, j]]
                    P[i, j] = w * value
            for a in range(cells.shape[1]):
                n = cells[e, a]
                for i in range(3):
                    force[n, i] += (
                        P[i, 0] * grad[e, g, a, 0] + P[i, 1] * grad[e, g, a, 1] + P[i, 2] * grad[e, g, a, 2]
                    )


@njit(cache=True, nogil=True)
def tangent(
    start, stop, u, cells, grad, weight, ops, par, base, scale, history, lame, volumes, pairs, slots, values
):
    """values (nnz of the upper triangle) += element tangents.

    volumes (n_cells, n_gauss): volume ratios that the pressures are taken at instead of det F;
    without cells, det F. lame (1 or n_cells): pressure per volume change.

    pairs (n_cells, n_nodes (n_nodes + 1) / 2): number of the node pair, times two, plus
    one where the pair is stored the other way round; slots (n_pairs, 3, 3): place of
    each entry in `values`, or -1.
    """
    work = workspace()
    n_nodes = cells.shape[1]
    F, S, CC = np.empty((3, 3)), np.empty(6), np.empty((6, 6))
    A, T = np.empty((9, 9)), np.empty((9, 6))
    D = np.empty((9, 3))
    K = np.empty((n_nodes * (n_nodes + 1) // 2, 3, 3))
    C, C_inv = np.empty(6), np.empty(6)
    has_history = history.shape[0] == cells.shape[0]
    mixed = volumes.shape[0] == cells.shape[0]
    for e in range(start, stop):
        row = e if par.shape[0] > 1 else 0
        K[:] = 0.0
        for g in range(weight.shape[1]):
            _gradient(u, cells[e], grad[e, g], base, F)
            J = second_piola(F, ops, par[row], S, CC, True, work)
            if mixed:
                stiffness = lame[e if lame.shape[0] > 1 else 0]
                _shift_pressure(F, J, stiffness * (volumes[e, g] - J), C, C_inv, S, CC)
            for q in range(6):
                S[q] *= scale
                if has_history:
                    S[q] += history[e, g, q]
                for r in range(6):
                    CC[q, r] *= scale
            _tangent9(F, S, CC, weight[e, g], A, T)
            t = 0
            for b in range(n_nodes):
                b0, b1, b2 = grad[e, g, b, 0], grad[e, g, b, 1], grad[e, g, b, 2]
                for p in range(9):
                    for k in range(3):
                        D[p, k] = A[p, 3 * k] * b0 + A[p, 3 * k + 1] * b1 + A[p, 3 * k + 2] * b2
                for a in range(b + 1):
                    a0, a1, a2 = grad[e, g, a, 0], grad[e, g, a, 1], grad[e, g, a, 2]
                    for i in range(3):
                        for k in range(3):
                            K[t, i, k] += a0 * D[3 * i, k] + a1 * D[3 * i + 1, k] + a2 * D[3 * i + 2, k]
                    t += 1
        for t in range(K.shape[0]):
            code = pairs[e, t]
            pair = code // 2
            swapped = code % 2 == 1
            for i in range(3):
                for k in range(3):
                    slot = slots[pair, k, i] if swapped else slots[pair, i, k]
                    if slot >= 0:
                        values[slot] += K[t, i, k]


@njit(cache=True, nogil=True)
def stress_state(start, stop, u, cells, grad, weight, ops, par, base, scale, history, F_out, S_out, CC_out):
    """F (n_cells, n_gauss, 3, 3), S (.., 6) and, if CC_out has cells, the tangent (.., 6, 6)."""
    work = workspace()
    CC = np.empty((6, 6))
    want = CC_out.shape[0] == cells.shape[0]
    has_history = history.shape[0] == cells.shape[0]
    for e in range(start, stop):
        row = e if par.shape[0] > 1 else 0
        for g in range(weight.shape[1]):
            _gradient(u, cells[e], grad[e, g], base, F_out[e, g])
            second_piola(F_out[e, g], ops, par[row], S_out[e, g], CC, want, work)
            for q in range(6):
                S_out[e, g, q] *= scale
                if has_history:
                    S_out[e, g, q] += history[e, g, q]
                if want:
                    for r in range(6):
                        CC_out[e, g, q, r] = scale * CC[q, r]
