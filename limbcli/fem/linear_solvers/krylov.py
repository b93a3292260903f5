"""Right-preconditioned GMRES."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from limbcli.fem.linear_solvers.singular import singular
from limbcli.fem.motion.state import norm
from limbcli.model import Array
from limbcli.numbers.compiled import njit

_NOTHING = 1e-12  # pivot regarded as round-off, relative to the largest entry of its column


def gmres(
    apply: Callable[[Array], Array],
    inverse: Callable[[Array], Array],
    rhs: Array,
    *,
    tolerance: float,
    max_iterations: int = 60,
) -> tuple[Array, int, float]:
    """Right-preconditioned GMRES: (solution, iterations, relative residual reached).

    On breakdown (the new Krylov vector is mapped to zero) the current solution is returned.

    Raises SingularMatrix if the right-hand side or a matrix-vector product is not finite.
    """
    size = norm(rhs)
    if not np.isfinite(size):
        raise singular("a residual is not finite")
    if size == 0.0:
        return np.zeros_like(rhs), 0, 0.0
    V = np.empty((max_iterations + 1, len(rhs)))
    V[0] = rhs / size
    Z: list[Array] = []
    H = np.zeros((max_iterations + 1, max_iterations))
    beta = np.zeros(max_iterations + 1)
    beta[0] = size
    cs, sn = np.zeros(max_iterations), np.zeros(max_iterations)
    n = 0
    for k in range(max_iterations):
        z = inverse(V[k])
        w = apply(z)
        Z.append(z)
        H[k + 1, k] = orthogonalise(V, k + 1, w, H[:, k])
        for j in range(k):
            H[j, k], H[j + 1, k] = (
                cs[j] * H[j, k] + sn[j] * H[j + 1, k],
                -sn[j] * H[j, k] + cs[j] * H[j + 1, k],
            )
        length = float(np.hypot(H[k, k], H[k + 1, k]))
        if not np.isfinite(length):
            raise singular("a product of it is not finite")
        if length <= _NOTHING * np.abs(H[: k + 1, k]).max(initial=0.0) or length == 0.0:
            break
        cs[k], sn[k] = H[k, k] / length, H[k + 1, k] / length
        last = H[k + 1, k]
        H[k, k], H[k + 1, k] = length, 0.0
        beta[k + 1] = -sn[k] * beta[k]
        beta[k] = cs[k] * beta[k]
        n = k + 1
        if abs(beta[k + 1]) <= tolerance * size or last == 0.0:
            break
        V[k + 1] = w / last
    y = np.linalg.solve(H[:n, :n], beta[:n])
    solution = np.zeros_like(rhs)
    for weight, z in zip(y, Z, strict=False):
        solution += weight * z
    return solution, n, abs(float(beta[n])) / size


@njit(fastmath={"reassoc", "contract"})
def orthogonalise(V, n, w, h):  # type: ignore[no-untyped-def]
    """Modified Gram-Schmidt: orthogonalise w against the first n rows of V, coefficients to h; returns |w|.

    One pass is enough for GMRES (Paige, Rozloznik and Strakos 2006, SIAM J. Matrix Anal. Appl. 28, 264-284).
    A plain loop: multithreaded BLAS is no faster for vectors of this length.
    """
    for j in range(n):
        dot = 0.0
        for i in range(len(w)):
            dot += V[j, i] * w[i]
        h[j] = dot
        for i in range(len(w)):
            w[i] -= dot * V[j, i]
    total = 0.0
    for i in range(len(w)):
        total += w[i] * w[i]
    return np.sqrt(total)
