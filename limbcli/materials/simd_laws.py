"""Stress and tangent at sixteen points at once: the counterpart of `dispatch.second_piola` for element loops.

All data of the sixteen points are stored in rows of one flat array (`simd`). Ogden's unconstrained law,
the tissue's, is vectorised with its own implementation; every other law is added point by point by
`second_piola`, so that a new law needs no code here. tests/materials/test_simd.py checks that both agree.

S = beta D + S_law, with D = C^-1; its tangent is alpha D (x) D + the symmetric product of D with X + CC_law.
Pressure, and Ogden terms with exponents 2 and -2, are expressed by numbers alpha and beta and a tensor X.
"""

from __future__ import annotations

from limbcli.materials.dispatch import second_piola
from limbcli.materials.kernel import OGDEN
from limbcli.materials.ogden import all_squares
from limbcli.materials.simd import (
    ALPHA,
    BETA,
    CC,
    KAPPA,
    LANES,
    SHIFT,
    UPPER,
    C,
    D,
    F,
    H,
    J,
    P,
    S,
    X,
    add_product,
    add_three,
)  # fmt: skip
from limbcli.materials.simd_ogden import add_powers, add_pressure, add_squares, principal_stretches
from limbcli.materials.tensors import FIRST, SECOND, VOIGT
from limbcli.numbers.compiled import njit


@njit
def measure(w):
    """J, C and D for all F. Where J is not positive, D is set to 0; the stress there is not meaningful."""
    for l in range(LANES):
        a, b, c = w[l], w[LANES + l], w[2 * LANES + l]
        d, e, f = w[3 * LANES + l], w[4 * LANES + l], w[5 * LANES + l]
        g, h, i = w[6 * LANES + l], w[7 * LANES + l], w[8 * LANES + l]
        jac = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        w[J * LANES + l] = jac
        xx, yy, zz = a * a + d * d + g * g, b * b + e * e + h * h, c * c + f * f + i * i
        xy, yz, xz = a * b + d * e + g * h, b * c + e * f + h * i, a * c + d * f + g * i
        at = C * LANES + l
        w[at], w[at + LANES], w[at + 2 * LANES] = xx, yy, zz
        w[at + 3 * LANES], w[at + 4 * LANES], w[at + 5 * LANES] = xy, yz, xz
        p, q, r = yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz
        det = xx * p + xy * q + xz * r
        part = 1.0 / det if jac > 0.0 else 0.0
        at = D * LANES + l
        w[at], w[at + LANES], w[at + 2 * LANES] = (
            p * part,
            (xx * zz - xz * xz) * part,
            (xx * yy - xy * xy) * part,
        )
        w[at + 3 * LANES], w[at + 4 * LANES], w[at + 5 * LANES] = (
            q * part,
            (xy * xz - xx * yz) * part,
            r * part,
        )


@njit
def add_laws(w, ops, par, rows, tangent, place, six, square, work):
    """Add the stress of the program at all points, after `measure` and before `finish`.

    rows (16,) : row of `par` for each point
    place (3, 3), six (6,), square (6, 6), work : workspace for laws evaluated point by point
    """
    w[S * LANES : (X + 6) * LANES] = 0.0
    spectral = False
    for leaf in range(ops.shape[0]):
        law, off, n_terms = ops[leaf, 0], ops[leaf, 1], ops[leaf, 2]
        if law != OGDEN:
            _add_by_points(w, ops[leaf : leaf + 1], par, rows, tangent, place, six, square, work)
            continue
        squares = True
        for l in range(LANES):
            w[KAPPA * LANES + l] = par[rows[l], off]
            squares &= all_squares(par[rows[l]], off, n_terms)
        add_pressure(w)
        if squares:
            add_squares(w, par, rows, off, n_terms)
            continue
        if not spectral:
            principal_stretches(w)
            spectral = True
        add_powers(w, par, rows, off, n_terms, tangent)


@njit
def _add_by_points(w, ops, par, rows, tangent, place, six, square, work):
    for l in range(LANES):
        for k in range(9):
            place[k // 3, k % 3] = w[(F + k) * LANES + l]
        second_piola(place, ops, par[rows[l]], six, square, tangent, work)
        for p in range(6):
            w[(S + p) * LANES + l] += six[p]
        if tangent:
            for p in range(6):
                for q in range(p, 6):
                    w[(CC + UPPER[p, q]) * LANES + l] += square[p, q]


@njit
def finish(w, tangent):
    """Add the pressures, including the extra pressure SHIFT; completes S and, if `tangent`, CC."""
    for l in range(LANES):
        shift = w[SHIFT * LANES + l] * w[J * LANES + l]
        w[ALPHA * LANES + l] += shift
        w[BETA * LANES + l] += shift
        half = 0.5 * w[BETA * LANES + l]
        w[H * LANES + l] = -half
    for p in range(6):
        add_product(w, S + p, BETA, D + p)
        add_product(w, X + p, H, D + p)
    if not tangent:
        return
    w[P * LANES : (P + 6) * LANES] = 0.0
    for p in range(6):
        add_product(w, P + p, ALPHA, D + p)
    k = CC
    for p in range(6):
        i, j = FIRST[p], SECOND[p]
        for q in range(p, 6):
            m, n = FIRST[q], SECOND[q]
            im, jn, i_n, jm = VOIGT[i, m], VOIGT[j, n], VOIGT[i, n], VOIGT[j, m]
            add_three(w, k, P + p, D + q, D + im, X + jn, X + im, D + jn)
            add_product(w, k, D + i_n, X + jm)
            add_product(w, k, X + i_n, D + jm)
            k += 1
