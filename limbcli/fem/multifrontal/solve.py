"""Forward and backward through the fronts, for one right-hand side or several."""

from __future__ import annotations

from numba import njit

from limbcli.fem.multifrontal.blas import gemm_nn, gemm_tn, trsm_left, trsm_left_t


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


@njit(cache=True, nogil=True, fastmath=True, boundscheck=False)
def _down(a, o, ld, p, m, y):  # type: ignore[no-untyped-def]
    """y -> L^-1 y for the first p, less L2 times that for the others."""
    j = 0
    while j + 4 <= p:
        c0 = o + j * ld
        c1, c2, c3 = c0 + ld, c0 + 2 * ld, c0 + 3 * ld
        y0 = y[j] / a[c0 + j]
        y1 = (y[j + 1] - a[c0 + j + 1] * y0) / a[c1 + j + 1]
        y2 = (y[j + 2] - a[c0 + j + 2] * y0 - a[c1 + j + 2] * y1) / a[c2 + j + 2]
        y3 = (y[j + 3] - a[c0 + j + 3] * y0 - a[c1 + j + 3] * y1 - a[c2 + j + 3] * y2) / a[c3 + j + 3]
        y[j], y[j + 1], y[j + 2], y[j + 3] = y0, y1, y2, y3
        a0, a1, a2, a3 = (
            a[c0 + j + 4 : c0 + m],
            a[c1 + j + 4 : c1 + m],
            a[c2 + j + 4 : c2 + m],
            a[c3 + j + 4 : c3 + m],
        )
        rest = y[j + 4 : m]
        for i in range(len(rest)):
            rest[i] -= a0[i] * y0 + a1[i] * y1 + a2[i] * y2 + a3[i] * y3
        j += 4
    while j < p:
        c0 = o + j * ld
        y0 = y[j] / a[c0 + j]
        y[j] = y0
        a0 = a[c0 + j + 1 : c0 + m]
        rest = y[j + 1 : m]
        for i in range(len(rest)):
            rest[i] -= a0[i] * y0
        j += 1


@njit(cache=True, nogil=True, fastmath=True, boundscheck=False)
def _up(a, o, ld, p, m, y):  # type: ignore[no-untyped-def]
    """The first p of y -> L^-T (y - L2^T of the others)."""
    zero = a.dtype.type(0)
    j = p
    while j - 4 >= 0:
        j -= 4
        c0 = o + j * ld
        c1, c2, c3 = c0 + ld, c0 + 2 * ld, c0 + 3 * ld
        s0, s1, s2, s3 = zero, zero, zero, zero
        a0, a1, a2, a3 = (
            a[c0 + j + 4 : c0 + m],
            a[c1 + j + 4 : c1 + m],
            a[c2 + j + 4 : c2 + m],
            a[c3 + j + 4 : c3 + m],
        )
        rest = y[j + 4 : m]
        for i in range(len(rest)):
            s0 += a0[i] * rest[i]
            s1 += a1[i] * rest[i]
            s2 += a2[i] * rest[i]
            s3 += a3[i] * rest[i]
        y3 = (y[j + 3] - s3) / a[c3 + j + 3]
        y2 = (y[j + 2] - s2 - a[c2 + j + 3] * y3) / a[c2 + j + 2]
        y1 = (y[j + 1] - s1 - a[c1 + j + 2] * y2 - a[c1 + j + 3] * y3) / a[c1 + j + 1]
        y0 = (y[j] - s0 - a[c0 + j + 1] * y1 - a[c0 + j + 2] * y2 - a[c0 + j + 3] * y3) / a[c0 + j]
        y[j], y[j + 1], y[j + 2], y[j + 3] = y0, y1, y2, y3
    while j > 0:
        j -= 1
        c0 = o + j * ld
        s0 = zero
        a0 = a[c0 + j + 1 : c0 + m]
        rest = y[j + 1 : m]
        for i in range(len(rest)):
            s0 += a0[i] * rest[i]
        y[j] = (y[j] - s0) / a[c0 + j]


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
