"""Forward and backward through the fronts, for one right-hand side or several."""

from __future__ import annotations

from numba import njit

from limbcli.fem.multifrontal.blas import gemm_nn, gemm_tn, trsm_left, trsm_left_t
from limbcli.fem.multifrontal.vectors import add_columns, add_scaled, dot_columns

TILE = 16  # columns of a triangle that is solved number by number


@njit(cache=True, nogil=True)
def enter(order, scaling, rhs, out):  # type: ignore[no-untyped-def]
    """Right-hand sides (n,) in the order of elimination, scaled."""
    for i in range(len(order)):
        e = order[i]
        out[i] = rhs[e] * scaling[e]


@njit(cache=True, nogil=True)
def leave(order, scaling, x, out):  # type: ignore[no-untyped-def]
    for i in range(len(order)):
        e = order[i]
        out[e] = x[i] * scaling[e]


@njit(cache=True, nogil=True)
def _down(a, o, ld, p, m, y):  # type: ignore[no-untyped-def]
    """y -> L^-1 y for the first p, less L2 times that for the others."""
    for j0 in range(0, p, TILE):
        j1 = min(j0 + TILE, p)
        for j in range(j0, j1):
            y[j] /= a[o + j * (ld + 1)]
            for i in range(j + 1, j1):
                y[i] -= a[o + i + j * ld] * y[j]
        j = j0
        while j + 4 <= j1:
            add_columns(y, j1, a, o + j1 + j * ld, ld, -y[j], -y[j + 1], -y[j + 2], -y[j + 3], m - j1)
            j += 4
        while j < j1:
            add_scaled(y, j1, a, o + j1 + j * ld, -y[j], m - j1)
            j += 1


@njit(cache=True, nogil=True)
def _up(a, o, ld, p, m, y):  # type: ignore[no-untyped-def]
    """The first p of y -> L^-T (y - L2^T of the others)."""
    for j0 in range((p - 1) // TILE * TILE, -1, -TILE):
        j1 = min(j0 + TILE, p)
        j = j1
        while j - 4 >= j0:
            j -= 4
            s0, s1, s2, s3 = dot_columns(y, j1, a, o + j1 + j * ld, ld, m - j1)
            y[j] -= s0
            y[j + 1] -= s1
            y[j + 2] -= s2
            y[j + 3] -= s3
        while j > j0:
            j -= 1
            for i in range(j1, m):
                y[j] -= a[o + i + j * ld] * y[i]
        for j in range(j1 - 1, j0 - 1, -1):
            for i in range(j + 1, j1):
                y[j] -= a[o + i + j * ld] * y[i]
            y[j] /= a[o + j * (ld + 1)]


@njit(cache=True, nogil=True)
def forward(plan, start, stop, panels, sign, w, y):  # type: ignore[no-untyped-def]
    """Fronts start..stop: pivots of w solved for, the rows below reduced. y: room for a front."""
    for s in range(start, stop):
        first, at = plan.pivot_at[s], plan.rows_at[s]
        p = plan.pivot_at[s + 1] - first
        r = plan.rows_at[s + 1] - at
        for i in range(p):
            y[i] = w[first + i]
        for i in range(p, p + r):
            y[i] = 0
        _down(panels, plan.panel_at[s], plan.ld[s], p, p + r, y)
        for i in range(p):
            w[first + i] = y[i] * sign[first + i]
        for i in range(r):
            w[plan.rows[at + i]] += y[p + i]


@njit(cache=True, nogil=True)
def backward(plan, start, stop, panels, w, y):  # type: ignore[no-untyped-def]
    """Fronts stop..start downwards: pivots of w from what is above them."""
    for s in range(stop - 1, start - 1, -1):
        first, at = plan.pivot_at[s], plan.rows_at[s]
        p = plan.pivot_at[s + 1] - first
        r = plan.rows_at[s + 1] - at
        for i in range(p):
            y[i] = w[first + i]
        for i in range(r):
            y[p + i] = w[plan.rows[at + i]]
        _up(panels, plan.panel_at[s], plan.ld[s], p, p + r, y)
        for i in range(p):
            w[first + i] = y[i]


@njit(cache=True, nogil=True)
def forward_many(blas, plan, start, stop, panels, sign, w, y):  # type: ignore[no-untyped-def]
    """As `forward`, for w (n, k)."""
    k = w.shape[1]
    one, none = panels.dtype.type(1), panels.dtype.type(0)
    for s in range(start, stop):
        first, at, o, ld = plan.pivot_at[s], plan.rows_at[s], plan.panel_at[s], plan.ld[s]
        p = plan.pivot_at[s + 1] - first
        r = plan.rows_at[s + 1] - at
        m = p + r
        for i in range(p):
            for c in range(k):
                y[c * m + i] = w[first + i, c]
        trsm_left(blas, p, k, panels, o, ld, y, 0, m)
        if r > 0:
            gemm_nn(blas, r, k, p, -one, panels, o + p, ld, y, 0, m, none, y, p, m)
        for i in range(p):
            for c in range(k):
                w[first + i, c] = y[c * m + i] * sign[first + i]
        for i in range(r):
            row = plan.rows[at + i]
            for c in range(k):
                w[row, c] += y[c * m + p + i]


@njit(cache=True, nogil=True)
def backward_many(blas, plan, start, stop, panels, w, y):  # type: ignore[no-untyped-def]
    """As `backward`, for w (n, k)."""
    k = w.shape[1]
    one = panels.dtype.type(1)
    for s in range(stop - 1, start - 1, -1):
        first, at, o, ld = plan.pivot_at[s], plan.rows_at[s], plan.panel_at[s], plan.ld[s]
        p = plan.pivot_at[s + 1] - first
        r = plan.rows_at[s + 1] - at
        m = p + r
        for i in range(p):
            for c in range(k):
                y[c * m + i] = w[first + i, c]
        for i in range(r):
            row = plan.rows[at + i]
            for c in range(k):
                y[c * m + p + i] = w[row, c]
        if r > 0:
            gemm_tn(blas, p, k, r, -one, panels, o + p, ld, y, p, m, one, y, 0, m)
        trsm_left_t(blas, p, k, panels, o, ld, y, 0, m)
        for i in range(p):
            for c in range(k):
                w[first + i, c] = y[c * m + i]


@njit(cache=True, nogil=True)
def pair(left, right, sign, ld, x, y):  # type: ignore[no-untyped-def]
    """Each column of x (n, k) -> (L S R^T)^-1 x."""
    n = len(x)
    for c in range(x.shape[1]):
        for i in range(n):
            y[i] = x[i, c]
        _down(left, 0, ld, n, n, y)
        for i in range(n):
            y[i] *= sign[i]
        _up(right, 0, ld, n, n, y)
        for i in range(n):
            x[i, c] = y[i]
