"""Compiled element loops that process sixteen integration points at a time: internal force and tangent.

Arguments as in `kernels`. The points of one or a few cells share the vectors of `materials.simd_laws`.
`internal_force` returns the smallest det F and its cell.
"""

from __future__ import annotations

import numpy as np

from limbcli.materials import simd_laws as lanes
from limbcli.materials.dispatch import workspace
from limbcli.materials.simd import (
    CC,
    LANES,
    PRODUCTS,
    SHIFT,
    STRESS,
    TANGENT,
    UPPER,
    WEIGHT,
    F,
    J,
    S,
    add_three,
    simd_workspace,
)
from limbcli.materials.tensors import VOIGT
from limbcli.numbers.compiled import njit

WIDTH = 12  # padded number of nodes per cell: a multiple of four, at least the largest number of nodes
_LONG = 6 * WIDTH


@njit
def _gradients(w, lane, u, nodes, grad, base):
    """F = base + sum of u (x) grad N at the points of a cell, into lanes from `lane` on.

    grad (n_gauss, n_nodes, 3)
    """
    own = np.empty(3 * WIDTH)
    n_nodes = nodes.shape[0]
    for a in range(n_nodes):
        n = nodes[a]
        own[3 * a], own[3 * a + 1], own[3 * a + 2] = u[n, 0], u[n, 1], u[n, 2]
    flat = grad.reshape(-1)
    at = 0
    for g in range(grad.shape[0]):
        f0, f1, f2 = base[0, 0], base[0, 1], base[0, 2]
        f3, f4, f5 = base[1, 0], base[1, 1], base[1, 2]
        f6, f7, f8 = base[2, 0], base[2, 1], base[2, 2]
        for a in range(n_nodes):
            x, y, z = own[3 * a], own[3 * a + 1], own[3 * a + 2]
            p, q, r = flat[at], flat[at + 1], flat[at + 2]
            f0 += x * p
            f1 += x * q
            f2 += x * r
            f3 += y * p
            f4 += y * q
            f5 += y * r
            f6 += z * p
            f7 += z * q
            f8 += z * r
            at += 3
        k = F * LANES + lane + g
        w[k], w[k + LANES], w[k + 2 * LANES] = f0, f1, f2
        w[k + 3 * LANES], w[k + 4 * LANES], w[k + 5 * LANES] = f3, f4, f5
        w[k + 6 * LANES], w[k + 7 * LANES], w[k + 8 * LANES] = f6, f7, f8


@njit
def _fill(w, rows, some, u, cells, grad, weight, par, base):
    """Fill F and weights of the points of some cells, F = 1 in unused lanes; returns how many points."""
    lane = np.int64(0)
    for e in some:
        _gradients(w, lane, u, cells[e], grad[e], base)
        for g in range(weight.shape[1]):
            w[WEIGHT * LANES + lane] = weight[e, g]
            rows[lane] = e if par.shape[0] > 1 else 0
            lane += 1
    for l in range(lane, LANES):
        rows[l] = rows[0]
        w[WEIGHT * LANES + l] = 0.0
        for k in range(9):
            w[(F + k) * LANES + l] = 1.0 if k % 4 == 0 else 0.0
    return lane


@njit
def _take_history(w, some, n_gauss, scale, history, tangent):
    """Stress = scale S + history, and the tangent scaled likewise."""
    if scale != 1.0:
        rows = 27 if tangent else 6
        for k in range(S * LANES, (S + rows) * LANES):
            w[k] *= scale
    if history.shape[0] > 0:
        for k in range(len(some)):
            for g in range(n_gauss):
                for q in range(6):
                    w[(S + q) * LANES + k * n_gauss + g] += history[some[k], g, q]


@njit
def _first_piola(w):
    """STRESS = weight F S, row by row."""
    for l in range(LANES):
        weight, at = w[WEIGHT * LANES + l], S * LANES + l
        a, b, c = w[at] * weight, w[at + LANES] * weight, w[at + 2 * LANES] * weight
        d, e, f = w[at + 3 * LANES] * weight, w[at + 4 * LANES] * weight, w[at + 5 * LANES] * weight
        for i in range(3):
            at = (F + 3 * i) * LANES + l
            x, y, z = w[at], w[at + LANES], w[at + 2 * LANES]
            at = (STRESS + 3 * i) * LANES + l
            w[at] = x * a + y * d + z * f
            w[at + LANES] = x * d + y * b + z * e
            w[at + 2 * LANES] = x * f + y * e + z * c


@njit
def _push(w, lane, nodes, grad, force):
    """force (n_points, 3) += P grad N at the points of a cell, whose lanes begin at `lane`."""
    own = np.zeros(3 * WIDTH)
    n_nodes = nodes.shape[0]
    flat = grad.reshape(-1)
    at = 0
    for g in range(grad.shape[0]):
        k = STRESS * LANES + lane + g
        p0, p1, p2 = w[k], w[k + LANES], w[k + 2 * LANES]
        p3, p4, p5 = w[k + 3 * LANES], w[k + 4 * LANES], w[k + 5 * LANES]
        p6, p7, p8 = w[k + 6 * LANES], w[k + 7 * LANES], w[k + 8 * LANES]
        for a in range(n_nodes):
            x, y, z = flat[at], flat[at + 1], flat[at + 2]
            own[3 * a] += p0 * x + p1 * y + p2 * z
            own[3 * a + 1] += p3 * x + p4 * y + p5 * z
            own[3 * a + 2] += p6 * x + p7 * y + p8 * z
            at += 3
    for a in range(n_nodes):
        n = nodes[a]
        force[n, 0] += own[3 * a]
        force[n, 1] += own[3 * a + 1]
        force[n, 2] += own[3 * a + 2]


@njit
def _worst(w, n):
    """The smallest det F of the first n points, and its lane."""
    worst, lowest = 1e300, -1
    for l in range(n):
        jac = w[J * LANES + l]
        if worst > jac:
            worst, lowest = jac, l
    return worst, lowest


@njit
def internal_force(start, stop, u, cells, grad, weight, ops, par, base, scale, history, force):
    """force (n_points, 3) += integral of P grad N."""
    w, one, six, square = simd_workspace()
    rows, work = np.zeros(LANES, dtype=np.int64), workspace()
    worst, lowest = 1e300, -1
    n_gauss = weight.shape[1]
    at_once = max(LANES // n_gauss, 1)
    want = np.bool_(False)  # no tangent; not a literal: see `materials.cache`
    for e0 in range(start, stop, at_once):
        some = np.arange(e0, min(e0 + at_once, stop))
        n = _fill(w, rows, some, u, cells, grad, weight, par, base)
        lanes.measure(w)
        lanes.add_laws(w, ops, par, rows, want, one, six, square, work)
        lanes.finish(w, want)
        _take_history(w, some, n_gauss, scale, history, want)
        _first_piola(w)
        low, lane = _worst(w, n)
        if worst > low:
            worst, lowest = low, e0 + lane // n_gauss
        for k in range(len(some)):
            _push(w, k * n_gauss, cells[some[k]], grad[some[k]], force)
    return worst, lowest


@njit
def _first_tangent(w):
    """PRODUCTS = weight dP_ij/dF_kl: nine rows (j, l) for each i <= k in VOIGT's order."""
    for k in range(S, S + 27):
        for l in range(LANES):
            w[k * LANES + l] *= w[WEIGHT * LANES + l]
    w[TANGENT * LANES : (PRODUCTS + 54) * LANES] = 0.0
    for i in range(3):
        for j in range(3):
            for q in range(6):
                to = TANGENT + 6 * (3 * i + j) + q
                a, b, c = CC + UPPER[VOIGT[0, j], q], CC + UPPER[VOIGT[1, j], q], CC + UPPER[VOIGT[2, j], q]
                add_three(w, to, F + 3 * i, a, F + 3 * i + 1, b, F + 3 * i + 2, c)
    for i in range(3):
        for k in range(i, 3):
            for j in range(3):
                of = TANGENT + 6 * (3 * i + j)
                for l in range(3):
                    to = PRODUCTS + 9 * VOIGT[i, k] + 3 * j + l
                    a, b, c = of + VOIGT[0, l], of + VOIGT[1, l], of + VOIGT[2, l]
                    add_three(w, to, F + 3 * k, a, F + 3 * k + 1, b, F + 3 * k + 2, c)
                    if i == k:
                        for x in range(LANES):
                            w[to * LANES + x] += w[(S + VOIGT[j, l]) * LANES + x]


@njit(fastmath={"contract"})
def _add_products(w, lane, grad, G, DG, K):
    """K[a, (ik, b)] = sum over points, j, l of grad[a, j] A[ij, kl] grad[b, l], for i <= k.

    Rows are padded with zeros beyond the nodes, so that the loops over them are vectorised.
    """
    n_gauss, n_nodes = grad.shape[0], grad.shape[1]
    for g in range(n_gauss):
        for a in range(n_nodes):
            for j in range(3):
                G[3 * g + j, a] = grad[g, a, j]
        for ik in range(6):
            for j in range(3):
                at = (PRODUCTS + 9 * ik + 3 * j) * LANES + lane + g
                x, y, z = w[at], w[at + LANES], w[at + 2 * LANES]
                row = DG[3 * g + j, ik * WIDTH : (ik + 1) * WIDTH]
                for b in range(WIDTH):
                    row[b] = x * G[3 * g, b] + y * G[3 * g + 1, b] + z * G[3 * g + 2, b]
    for a in range(n_nodes):
        row = K[a]
        row[:] = 0.0
        for g in range(n_gauss):
            x, y, z = G[3 * g, a], G[3 * g + 1, a], G[3 * g + 2, a]
            for t in range(_LONG):
                row[t] += x * DG[3 * g, t] + y * DG[3 * g + 1, t] + z * DG[3 * g + 2, t]


@njit
def _scatter_blocks(pairs, K, n_nodes, blocks):
    """Add a cell's K to the flat blocks of its node pairs."""
    for b in range(n_nodes):
        for a in range(b + 1):
            code = pairs[b * (b + 1) // 2 + a]
            low, high = (b, a) if code % 2 == 1 else (a, b)
            at = 9 * (code // 2)
            up, down = K[low], K[high]
            blocks[at] += up[high]
            blocks[at + 4] += up[WIDTH + high]
            blocks[at + 8] += up[2 * WIDTH + high]
            blocks[at + 1] += up[3 * WIDTH + high]
            blocks[at + 5] += up[4 * WIDTH + high]
            blocks[at + 2] += up[5 * WIDTH + high]
            blocks[at + 3] += down[3 * WIDTH + low]
            blocks[at + 7] += down[4 * WIDTH + low]
            blocks[at + 6] += down[5 * WIDTH + low]


@njit
def tangent(
    start, stop, u, cells, grad, weight, ops, par, base, scale, history, lame, volumes, order, pairs, blocks
):
    """blocks (n_pairs, 3, 3) += element tangents.

    volumes (n_cells, n_gauss) : volume ratios at which pressures are evaluated; if empty, det F is used
    lame (1 or n_cells) : pressure per volume change
    order (n_cells,) : order in which the cells are processed
    pairs (n_cells, n_nodes (n_nodes + 1) / 2) : twice the number of the node pair, plus one if the pair is
        stored in reversed order
    """
    w, one, six, square = simd_workspace()
    rows, work = np.zeros(LANES, dtype=np.int64), workspace()
    n_nodes, n_gauss = cells.shape[1], weight.shape[1]
    G, DG = np.zeros((3 * n_gauss, WIDTH)), np.zeros((3 * n_gauss, _LONG))
    K = np.zeros((n_nodes, _LONG))
    independent = volumes.shape[0] == cells.shape[0]
    flat = blocks.reshape(-1)
    at_once = max(LANES // n_gauss, 1)
    want = np.bool_(True)
    for e0 in range(start, stop, at_once):
        some = order[e0 : min(e0 + at_once, stop)]
        n = _fill(w, rows, some, u, cells, grad, weight, par, base)
        lanes.measure(w)
        lanes.add_laws(w, ops, par, rows, want, one, six, square, work)
        for l in range(n):
            e = some[l // n_gauss]
            if independent:
                stiffness = lame[e if lame.shape[0] > 1 else 0]
                w[SHIFT * LANES + l] = stiffness * (volumes[e, l % n_gauss] - w[J * LANES + l])
        lanes.finish(w, want)
        _take_history(w, some, n_gauss, scale, history, want)
        _first_tangent(w)
        for k in range(len(some)):
            _add_products(w, k * n_gauss, grad[some[k]], G, DG, K)
            _scatter_blocks(pairs[some[k]], K, n_nodes, flat)
