"""Numerical factorisation: assembly and factorisation of fronts, and their update matrices."""

from __future__ import annotations

import numpy as np

from limbcli.fem.linear_solvers.multifrontal.compact_factor import keep
from limbcli.fem.linear_solvers.multifrontal.dense import NOT_FINITE, factor_panel, form_update
from limbcli.fem.linear_solvers.multifrontal.vectors import add
from limbcli.numbers.compiled import njit

BLOCK = 192  # columns per block of a front factored by one thread


@njit
def scales(indptr, indices, values, first, stop, out):  # type: ignore[no-untyped-def]
    """Scale factors 1/sqrt(|diagonal|) of rows first..stop; 0 where the diagonal is zero."""
    for i in range(first, stop):
        diagonal = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] == i:
                diagonal += values[k]
        out[i] = 1.0 / np.sqrt(abs(diagonal)) if abs(diagonal) > 1e-300 else 0.0


@njit
def scales_of_others(indptr, indices, values, out):  # type: ignore[no-untyped-def]
    """Scale factors of rows with a zero diagonal, from their largest entry in the scaled matrix."""
    n = len(indptr) - 1
    largest = np.zeros(n)
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            j, size = indices[k], abs(values[k])
            if out[i] == 0.0:
                largest[i] = max(largest[i], size * (out[j] if out[j] > 0.0 else 1.0))
            if out[j] == 0.0:
                largest[j] = max(largest[j], size * (out[i] if out[i] > 0.0 else 1.0))
    for i in range(n):
        if out[i] == 0.0:
            out[i] = 1.0 / largest[i] if largest[i] > 0.0 else 1.0


@njit
def scale(indptr, indices, values, scaling, first, stop, out):  # type: ignore[no-untyped-def]
    """Scale rows first..stop of the matrix and convert them to the factor's precision."""
    for i in range(first, stop):
        for k in range(indptr[i], indptr[i + 1]):
            out[k] = values[k] * (scaling[i] * scaling[indices[k]])


@njit
def gather_panel(plan, s, c0, c1, values, panel, updates):  # type: ignore[no-untyped-def]
    """Assemble pivot columns c0..c1 of front s: matrix entries plus the children's update matrices."""
    ld = plan.ld[s]
    panel[c0 * ld : c1 * ld] = 0
    first = plan.pivot_at[s]
    for k in range(plan.column_at[first + c0], plan.column_at[first + c1]):
        panel[plan.entry_to[k]] += values[plan.entry_from[k]]
    for c in range(plan.child_at[s], plan.child_at[s + 1]):
        _extend(plan, plan.children[c], c0, c1, np.int64(0), ld, updates, panel)


@njit
def gather_update(plan, s, c0, c1, updates):  # type: ignore[no-untyped-def]
    """Add the children's update matrices to columns c0..c1 of the update matrix of front s."""
    p = plan.pivot_at[s + 1] - plan.pivot_at[s]
    o = plan.update_at[s] - p * (plan.ldu[s] + 1)  # offset such that positions in the front can be used
    for c in range(plan.child_at[s], plan.child_at[s + 1]):
        _extend(plan, plan.children[c], p + c0, p + c1, o, plan.ldu[s], updates, updates)


@njit
def _extend(plan, c, c0, c1, o, ld, updates, target):  # type: ignore[no-untyped-def]
    """Extend-add: the columns of front c's update matrix that map to columns c0..c1 of its parent."""
    at = plan.rows_at[c]
    n = plan.rows_at[c + 1] - at
    into = plan.into[at : at + n]
    u, ldu = plan.update_at[c], plan.ldu[c]
    low, high = plan.run_at[c], plan.run_at[c + 1]
    run = low
    for j in range(np.searchsorted(into, c0), np.searchsorted(into, c1)):
        column = o + into[j] * ld
        while run + 1 < high and plan.runs[run + 1] <= j:
            run += 1
        begin = j
        for k in range(run, high):
            end = plan.runs[k + 1] if k + 1 < high else n
            source = u + j * ldu + begin
            to = column + into[begin]
            add(target, to, updates, source, end - begin)
            begin = end


@njit
def factor_subtree(blas, plan, start, stop, values, panel, updates, kept, sign, tiny, inverse, work):  # type: ignore[no-untyped-def]
    """Factor fronts start..stop one after another; returns the number of perturbed pivots, or NOT_FINITE."""
    made_up = 0
    begin, whole, block = np.int64(0), np.int64(-1), np.int64(BLOCK)  # shared kernels: see `materials.cache`
    for s in range(start, stop):
        first = plan.pivot_at[s]
        p = plan.pivot_at[s + 1] - first
        r = plan.rows_at[s + 1] - plan.rows_at[s]
        ld = plan.ld[s]
        gather_panel(plan, s, begin, p, values, panel, updates)
        found = factor_panel(blas, panel, begin, ld, p, p + r, block, sign, first, tiny, inverse, work)
        if found < 0:
            return NOT_FINITE
        made_up += found
        if r > 0:
            u, ldu = plan.update_at[s], plan.ldu[s]
            form_update(blas, panel, begin, ld, p, p + r, updates, u, ldu, begin, r, block, sign, first, work)
            gather_update(plan, s, begin, r, updates)
        keep(kept, plan.tile_at[s], plan.part_at[s], first, panel, begin, ld, p, p + r, whole)
    return made_up
