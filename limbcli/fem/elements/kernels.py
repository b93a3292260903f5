"""Compiled element loops that process one integration point at a time: volumes, tangent products, stresses.

The time-critical loops, internal force and tangent, are in `simd_kernels`.

All loops run over a range of cells and release the GIL, so that threads can share the work. `u` is
(n_points, 3); F = base + sum u (x) grad N, where base is the unit tensor, or the prestrain gradient (with
grad N transformed accordingly). Stress is scale * S + history, which covers Prony series.

A group of cells is passed as (cells, grad, weight, ops, par, base, scale, history): see
`fem.elements.groups.Operands`.
"""

from __future__ import annotations

import numpy as np

from limbcli.materials.dispatch import second_piola, workspace
from limbcli.materials.tensors import FIRST, SECOND, VOIGT, inverse6, right_cauchy_green
from limbcli.numbers.compiled import njit


@njit
def _gather(u, nodes, own):
    """Copy the rows of u of a cell's nodes to own (n_nodes, 3)."""
    for a in range(nodes.shape[0]):
        n = nodes[a]
        own[a, 0], own[a, 1], own[a, 2] = u[n, 0], u[n, 1], u[n, 2]


@njit
def _scatter(own, nodes, out):
    """Add a cell's nodal values own (n_nodes, 3) to out (n_points, 3)."""
    for a in range(nodes.shape[0]):
        n = nodes[a]
        out[n, 0] += own[a, 0]
        out[n, 1] += own[a, 1]
        out[n, 2] += own[a, 2]


@njit
def _gradient(own, grad, base, F):
    """F = base + sum over the nodes of own (x) grad."""
    f00, f01, f02 = base[0, 0], base[0, 1], base[0, 2]
    f10, f11, f12 = base[1, 0], base[1, 1], base[1, 2]
    f20, f21, f22 = base[2, 0], base[2, 1], base[2, 2]
    for a in range(own.shape[0]):
        x, y, z = own[a, 0], own[a, 1], own[a, 2]
        gx, gy, gz = grad[a, 0], grad[a, 1], grad[a, 2]
        f00 += x * gx
        f01 += x * gy
        f02 += x * gz
        f10 += y * gx
        f11 += y * gy
        f12 += y * gz
        f20 += z * gx
        f21 += z * gy
        f22 += z * gz
    F[0, 0], F[0, 1], F[0, 2] = f00, f01, f02
    F[1, 0], F[1, 1], F[1, 2] = f10, f11, f12
    F[2, 0], F[2, 1], F[2, 2] = f20, f21, f22


@njit
def _add_force(P, grad, own):
    """own (n_nodes, 3) += P grad."""
    for a in range(own.shape[0]):
        gx, gy, gz = grad[a, 0], grad[a, 1], grad[a, 2]
        own[a, 0] += P[0, 0] * gx + P[0, 1] * gy + P[0, 2] * gz
        own[a, 1] += P[1, 0] * gx + P[1, 1] * gy + P[1, 2] * gz
        own[a, 2] += P[2, 0] * gx + P[2, 1] * gy + P[2, 2] * gz


@njit
def _shift_pressure(F, J, shift, C, D, S, CC):
    """Add a pressure `shift` to S and CC: shift J C^-1 and its derivative."""
    right_cauchy_green(F, C)
    inverse6(C, D)
    for q in range(6):
        S[q] += shift * J * D[q]
        i, j = FIRST[q], SECOND[q]
        for r in range(q, 6):
            k, l = FIRST[r], SECOND[r]
            value = D[q] * D[r] - D[VOIGT[i, k]] * D[VOIGT[j, l]] - D[VOIGT[i, l]] * D[VOIGT[j, k]]
            CC[q, r] += shift * J * value
            if r > q:
                CC[r, q] += shift * J * value


@njit
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


@njit
def linear_volumes(start, stop, u, v, cells, grad, base, out):
    """out (n_cells, n_gauss) = det F at u plus its linear change along v (n_points, 3)."""
    F, dF, B = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    zero = np.zeros((3, 3))
    own, change = np.empty((cells.shape[1], 3)), np.empty((cells.shape[1], 3))
    for e in range(start, stop):
        _gather(u, cells[e], own)
        _gather(v, cells[e], change)
        for g in range(grad.shape[1]):
            _gradient(own, grad[e, g], base, F)
            _gradient(change, grad[e, g], zero, dF)
            total = _cofactor(F, B)
            for i in range(3):
                for j in range(3):
                    total += B[i, j] * dF[i, j]
            out[e, g] = total


@njit
def volume_force(start, stop, u, cells, grad, weight, base, lame, volumes, force):
    """force (n_points, 3) += change of the internal force for pressures at `volumes` instead of det F."""
    F, B = np.empty((3, 3)), np.empty((3, 3))
    own = np.empty((cells.shape[1], 3))
    pushes = np.empty((cells.shape[1], 3))
    for e in range(start, stop):
        _gather(u, cells[e], own)
        stiffness = lame[e if lame.shape[0] > 1 else 0]
        pushes[:] = 0.0
        for g in range(weight.shape[1]):
            _gradient(own, grad[e, g], base, F)
            shift = weight[e, g] * stiffness * (volumes[e, g] - _cofactor(F, B))
            for i in range(3):
                for j in range(3):
                    B[i, j] *= shift
            _add_force(B, grad[e, g], pushes)
        _scatter(pushes, cells[e], force)


@njit
def _strain_change(F, dF, E):
    """E (6,) = change of Green's strain, with engineering shears, for a change dF of F."""
    for i in range(3):
        for j in range(i, 3):
            value = 0.0
            for k in range(3):
                value += F[k, i] * dF[k, j] + dF[k, i] * F[k, j]
            E[VOIGT[i, j]] = 0.5 * value * (1.0 if i == j else 2.0)


@njit
def tangent_times(
    start, stop, u, cells, grad, weight, ops, par, base, scale, history, lame, volumes, v, force
):
    """force (n_points, 3) += K(u) v; pressures at `volumes` (n_cells, n_gauss) unless it is empty."""
    work = workspace()
    F, S, CC = np.empty((3, 3)), np.empty(6), np.empty((6, 6))
    dF, E, dS, P = np.empty((3, 3)), np.empty(6), np.empty(6), np.empty((3, 3))
    zero = np.zeros((3, 3))
    C, D = np.empty(6), np.empty(6)
    has_history = history.shape[0] == cells.shape[0]
    independent = volumes.shape[0] == cells.shape[0]
    own, change = np.empty((cells.shape[1], 3)), np.empty((cells.shape[1], 3))
    pushes = np.empty((cells.shape[1], 3))
    for e in range(start, stop):
        _gather(u, cells[e], own)
        _gather(v, cells[e], change)
        row = e if par.shape[0] > 1 else 0
        pushes[:] = 0.0
        for g in range(weight.shape[1]):
            _gradient(own, grad[e, g], base, F)
            _gradient(change, grad[e, g], zero, dF)
            J = second_piola(F, ops, par[row], S, CC, np.bool_(True), work)
            if independent:
                stiffness = lame[e if lame.shape[0] > 1 else 0]
                _shift_pressure(F, J, stiffness * (volumes[e, g] - J), C, D, S, CC)
            w = weight[e, g]
            _strain_change(F, dF, E)
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
            _add_force(P, grad[e, g], pushes)
        _scatter(pushes, cells[e], force)


@njit
def slope_times(start, stop, nodes, grad, F, slope, v, force):
    """force (n_points, 3) += K v of individual integration points.

    nodes (n, n_nodes) : of their cells; grad (n, n_nodes, 3) : grad N; F (n, 3, 3)
    slope (n, 6, 6) : tangent times the point's volume
    """
    zero = np.zeros((3, 3))
    dF, E, P = np.empty((3, 3)), np.empty(6), np.empty((3, 3))
    change, pushes = np.empty((nodes.shape[1], 3)), np.empty((nodes.shape[1], 3))
    for n in range(start, stop):
        _gather(v, nodes[n], change)
        _gradient(change, grad[n], zero, dF)
        _strain_change(F[n], dF, E)
        dS = slope[n] @ E
        for i in range(3):
            for j in range(3):
                value = 0.0
                for k in range(3):
                    value += F[n, i, k] * dS[VOIGT[k, j]]
                P[i, j] = value
        pushes[:] = 0.0
        _add_force(P, grad[n], pushes)
        _scatter(pushes, nodes[n], force)


@njit
def stress_state(start, stop, u, cells, grad, weight, ops, par, base, scale, history, F_out, S_out, CC_out):
    """F (n_cells, n_gauss, 3, 3), S (.., 6) and, if CC_out has n_cells rows, the tangent (.., 6, 6)."""
    work = workspace()
    CC = np.empty((6, 6))
    want = CC_out.shape[0] == cells.shape[0]
    has_history = history.shape[0] == cells.shape[0]
    own = np.empty((cells.shape[1], 3))
    for e in range(start, stop):
        _gather(u, cells[e], own)
        row = e if par.shape[0] > 1 else 0
        for g in range(weight.shape[1]):
            _gradient(own, grad[e, g], base, F_out[e, g])
            second_piola(F_out[e, g], ops, par[row], S_out[e, g], CC, want, work)
            for q in range(6):
                S_out[e, g, q] *= scale
                if has_history:
                    S_out[e, g, q] += history[e, g, q]
                if want:
                    for r in range(6):
                        CC_out[e, g, q, r] = scale * CC[q, r]
