"""Single compiled entry point for all laws: `second_piola` sums the leaves of a program.

A program consists of `ops` (n_leaves, 3) int64, with rows (kernel number, offset of the law's numbers in the
parameter row, extra), and one row of numbers `par` per cell (or one for all). Sums of laws (mixtures) have
several rows in `ops`. Kernel numbers are explained in `kernel`; they are valid within one process.
"""

from __future__ import annotations

from limbcli.materials.kernel import OGDEN, call_kernel, workspace
from limbcli.materials.ogden import add_ogden
from limbcli.materials.tensors import determinant, right_cauchy_green
from limbcli.numbers.compiled import njit

__all__ = ["second_piola", "workspace"]


@njit
def second_piola(F, ops, par, S, CC, tangent, work):
    """Set S (6) and, if `tangent`, CC (6, 6) of a program at F; zero where det F <= 0. Returns det F."""
    J = determinant(F)
    S[:] = 0.0
    if tangent:
        CC[:, :] = 0.0
    if J <= 0.0:
        return J
    right_cauchy_green(F, work[0][0])
    work[1][0, 0] = -1.0  # marks the principal axes as not computed
    for leaf in range(ops.shape[0]):
        law, off, extra = ops[leaf, 0], ops[leaf, 1], ops[leaf, 2]
        if law == OGDEN:
            add_ogden(par, off, extra, J, work, S, CC, tangent)
        else:
            call_kernel(law, par, off, extra, J, work, S, CC, tangent)
    return J
