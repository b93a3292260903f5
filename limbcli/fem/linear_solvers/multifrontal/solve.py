"""Compiled forward and backward substitution through the fronts, for one right-hand side."""

from __future__ import annotations

import numpy as np

from limbcli.fem.linear_solvers.multifrontal.compact_factor import PAD, down, up
from limbcli.fem.linear_solvers.multifrontal.tiles import TILE
from limbcli.numbers.compiled import njit


@njit
def enter(order, scaling, rhs, out):  # type: ignore[no-untyped-def]
    """Scale the right-hand side (n,) and permute it to elimination order."""
    for i in range(len(order)):
        e = order[i]
        out[i] = rhs[e] * scaling[e]


@njit
def leave(order, scaling, x, out):  # type: ignore[no-untyped-def]
    for i in range(len(order)):
        e = order[i]
        out[e] = x[i] * scaling[e]


@njit
def forward(plan, start, stop, kept, sign, w, y, z):  # type: ignore[no-untyped-def]
    """Forward substitution through fronts start..stop. y, z : workspace (a front, a tile)"""
    for s in range(start, stop):
        first, at = plan.pivot_at[s], plan.rows_at[s]
        p = plan.pivot_at[s + 1] - first
        r = plan.rows_at[s + 1] - at
        for i in range(p):
            y[i] = w[first + i]
        for i in range(p, p + r + PAD):
            y[i] = 0
        down(kept, plan.tile_at[s], plan.part_at[s], first, p, p + r, y, z)
        for i in range(p):
            w[first + i] = y[i] * sign[first + i]
        for i in range(r):
            w[plan.rows[at + i]] += y[p + i]


@njit
def backward(plan, start, stop, kept, w, y, z):  # type: ignore[no-untyped-def]
    """Backward substitution through fronts stop - 1 down to start."""
    for s in range(stop - 1, start - 1, -1):
        first, at = plan.pivot_at[s], plan.rows_at[s]
        p = plan.pivot_at[s + 1] - first
        r = plan.rows_at[s + 1] - at
        for i in range(p):
            y[i] = w[first + i]
        for i in range(r):
            y[p + i] = w[plan.rows[at + i]]
        for i in range(p + r, p + r + PAD):
            y[i] = 0
        up(kept, plan.tile_at[s + 1], plan.part_at[s + 1], first, p, p + r, y, z)
        for i in range(p):
            w[first + i] = y[i]


@njit
def whole(kept, sign, w, y, z):  # type: ignore[no-untyped-def]
    """w -> (L S L^T)^-1 w for a matrix that is a single front."""
    n, begin = len(w), np.int64(0)  # not a literal: see `materials.cache`
    for i in range(n):
        y[i] = w[i]
    y[n : n + PAD] = 0
    down(kept, begin, begin, begin, n, n, y, z)
    for i in range(n):
        y[i] *= sign[i]
    y[n : n + PAD] = 0
    up(kept, len(kept.inverses) // (TILE * TILE), len(kept.parts), begin, n, n, y, z)
    for i in range(n):
        w[i] = y[i]
