"""One compiled entry for every law: `second_piola` adds up the leaves of a program.

A program is `ops` (n_leaves, 3) int64, each row (the kernel's number, offset of its numbers in the
parameter row, extra), with one row of numbers `par` per cell (or one for all). Sums of laws (mixtures) are
several rows. What a number means is stated in `kernel`; it holds in one process.
"""

from __future__ import annotations

from numba import njit

from limbcli.materials.kernel import OGDEN, call_kernel, workspace
from limbcli.materials.ogden import add_ogden
from limbcli.materials.tensors import determinant, right_cauchy_green

__all__ = ["second_piola", "workspace"]


@njit(cache=True)
def second_piola(F, ops, par, S, CC, tangent, work):
    """S (6) and, if `tangent`, CC (6, 6) of the program at F. Returns det F; below or at 0 nothing is set."""
    J = determinant(F)
    S[:] = 0.0
    if tangent:
        CC[:, :] = 0.0
    if J <= 0.0:
        return J
    right_cauchy_green(F, work[0][0])
    work[1][0, 0] = -1.0  # no principal axes yet
    for leaf in range(ops.shape[0]):
        law, off, extra = ops[leaf, 0], ops[leaf, 1], ops[leaf, 2]
        if law == OGDEN:
            add_ogden(par, off, extra, J, work, S, CC, tangent)
        else:
            call_kernel(law, par, off, extra, J, work, S, CC, tangent)
    return J
