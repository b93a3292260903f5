"""Ogden's law, unconstrained (FEBio "Ogden unconstrained"), in the tissue's parameters; up to six terms:

    W = sum_k c_k/m_k^2 (l1^m_k + l2^m_k + l3^m_k - 3 - m_k ln J) + kappa/2 (J - 1)^2

with ground-state shear modulus sum(c_k)/2 and kappa Lame's lambda. The tissue law of the project,
Psi = c/(2 m^2) sum(l^m + l^-m - 2) + kappa/2 (J - 1)^2, has c1 = c2 = c/2, m1 = m, m2 = -m, for which the
logarithms cancel. The loops over the elements evaluate it at sixteen points at once, in `simd_ogden`.

Source: FEBio User Manual 4.0, "Ogden Unconstrained".
"""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.errors import SolveError
from limbcli.materials.kernel import OGDEN, Deformation, Kernel
from limbcli.materials.law import FebioNames, Law, Values
from limbcli.materials.principal import add_principal, principal_axes
from limbcli.materials.tensors import FIRST, SECOND, VOIGT, inverse6, square6
from limbcli.model import ElementMap, Material
from limbcli.numbers.compiled import njit

MAX_TERMS = 6


def ogden_type(*, c: float, f_kappa: float, m: float) -> Material:
    """The tissue law: Psi = c/(2 m^2) sum(l^m + l^-m - 2) + f_kappa c/2 (J - 1)^2.

    c : twice the ground-state shear modulus, MPa; f_kappa, m : dimensionless. m = 2 is the
    "Mooney-Rivlin type".

    >>> ogden_type(c=0.005, f_kappa=100.0, m=2.0).parameters["kappa"]
    0.5
    """
    if not (np.isfinite([c, f_kappa, m]).all() and c > 0 and f_kappa > 0 and m != 0):
        raise SolveError(
            f"no Ogden law with c = {c}, f_kappa = {f_kappa}, m = {m}",
            where="material parameters",
            fix="c and f_kappa must be positive and m not zero",
            c=c,
            f_kappa=f_kappa,
            m=m,
        )
    return Material("ogden", {"c1": c / 2, "m1": m, "c2": c / 2, "m2": -m, "kappa": f_kappa * c})


@njit
def power_quotient(m, si, sj, pi, pj):
    """(l_j^m - l_i^m) / (l_j^2 - l_i^2) without cancellation; s squares, p powers."""
    x = (sj - si) / si
    if abs(x) > 1e-2:
        return (pj - pi) / (sj - si)
    if x == 0.0:
        return 0.5 * m * pi / si
    return pi * np.expm1(0.5 * m * np.log1p(x)) / (x * si)


@njit
def powers(x):
    """exp(x) - 1, exp(x), exp(-x) - 1 and exp(-x), all without cancellation."""
    above = np.expm1(abs(x))
    high = 1.0 + above
    if x >= 0.0:
        return above, high, -above / high, 1.0 / high
    return -above / high, 1.0 / high, above, high


@njit
def all_squares(par, off, n_terms):
    """Whether all exponents of nonzero terms are 2 or -2, so that no principal stretches are needed."""
    n_others = 0
    for k in range(n_terms):
        if par[off + 1 + 2 * k] != 0.0 and abs(par[off + 2 + 2 * k]) != 2.0:
            n_others += 1
    return n_others == 0


@njit
def add_ogden(par, off, n_terms, J, work, S, CC, tangent):
    """par[off:] = kappa, c1, m1, c2, m2, ..."""
    if all_squares(par, off, n_terms):
        _add_squares(par, off, n_terms, J, work[0][0], work[0][1], work[0][2], S, CC, tangent)
        return
    principal_axes(work)
    three = work[1]
    _add_powers(
        par, off, n_terms, J, three[0], three[1], work[2], three[2], work[3], three[3], S, CC, tangent
    )


@njit
def _add_squares(par, off, n_terms, J, C, D, G, S, CC, tangent):
    """All exponents 2 or -2: in terms of C, D = C^-1 and G = D^2 (6 each; D and G are workspace).

    S = kappa (J - 1) J D + c+/2 (1 - D) + c-/2 (D - G), c+ and c- the sums of c_k of either sign.
    """
    inverse6(C, D)
    square6(D, G)
    plus, minus = 0.0, 0.0
    for k in range(n_terms):
        if par[off + 2 + 2 * k] > 0.0:
            plus += par[off + 1 + 2 * k]
        else:
            minus += par[off + 1 + 2 * k]
    inner = par[off] * (J - 1.0) * J + 0.5 * (minus - plus)
    for q in range(6):
        S[q] += inner * D[q] - 0.5 * minus * G[q]
    for q in range(3):
        S[q] += 0.5 * plus
    if not tangent:
        return
    slope = par[off] * (2.0 * J - 1.0) * J
    for p in range(6):
        i, j = FIRST[p], SECOND[p]
        for q in range(p, 6):
            k, l = FIRST[q], SECOND[q]
            ik, jl, il, jk = VOIGT[i, k], VOIGT[j, l], VOIGT[i, l], VOIGT[j, k]
            value = slope * D[p] * D[q] - inner * (D[ik] * D[jl] + D[il] * D[jk])
            value += 0.5 * minus * (D[ik] * G[jl] + D[il] * G[jk] + G[ik] * D[jl] + G[il] * D[jk])
            CC[p, q] += value
            if q > p:
                CC[q, p] += value


@njit
def _add_powers(par, off, n_terms, J, squares, logs, vectors, tau, a, d, S, CC, tangent):
    """Any exponents: in principal axes; logs = ln l_i."""
    pressure = par[off] * (J - 1.0) * J
    slope = par[off] * (2.0 * J - 1.0) * J
    for i in range(3):
        tau[i] = pressure
        d[i] = 0.0
        for j in range(3):
            a[i, j] = slope
    e0 = e1 = e2 = r0 = r1 = r2 = 0.0
    p0 = p1 = p2 = q0 = q1 = q2 = 1.0
    for k in range(n_terms):
        c = par[off + 1 + 2 * k]
        if c == 0.0:
            continue
        m = par[off + 2 + 2 * k]
        if k > 0 and m == -par[off + 2 * k] and par[off + 2 * k - 1] != 0.0:  # previous term's, inverted
            e0, p0, r0, q0 = r0, q0, e0, p0
            e1, p1, r1, q1 = r1, q1, e1, p1
            e2, p2, r2, q2 = r2, q2, e2, p2
        else:
            e0, p0, r0, q0 = powers(m * logs[0])
            e1, p1, r1, q1 = powers(m * logs[1])
            e2, p2, r2, q2 = powers(m * logs[2])
        tau[0] += c / m * e0
        tau[1] += c / m * e1
        tau[2] += c / m * e2
        if tangent:
            a[0, 0] += c * p0
            a[1, 1] += c * p1
            a[2, 2] += c * p2
            d[0] += c / m * power_quotient(m, squares[0], squares[1], p0, p1)
            d[1] += c / m * power_quotient(m, squares[1], squares[2], p1, p2)
            d[2] += c / m * power_quotient(m, squares[0], squares[2], p0, p2)
    add_principal(squares, vectors, tau, a, d, S, CC, tangent)


@njit
def add_exponent_derivative(par, off, term, J, work, S, CC, tangent):
    """dS/dm of one term: tau_i = c (l^m ln l / m - (l^m - 1) / m^2)."""
    principal_axes(work)
    squares, logs, tau, d = work[1][0], work[1][1], work[1][2], work[1][3]
    c, m = par[off + 1 + 2 * term], par[off + 2 + 2 * term]
    for i in range(3):
        tau[i] = c * (np.exp(m * logs[i]) * logs[i] / m - np.expm1(m * logs[i]) / (m * m))
    add_principal(squares, work[2], tau, work[3], d, S, CC, False)


# ---------------------------------------------------------------- sums of terms, coupled or uncoupled

PARAMETERS: dict[str, float | None] = {"kappa": None, "c1": None, "m1": None}
PARAMETERS |= {f"{letter}{k}": 0.0 for k in range(2, MAX_TERMS + 1) for letter in "cm"}
FEBIO_TERMS = tuple((f"{letter}{k}", f"{letter}{k}") for k in range(1, MAX_TERMS + 1) for letter in "cm")


def n_terms(values: Values) -> int:
    """The highest number of a given term."""
    return max((k for k in range(1, MAX_TERMS + 1) if f"c{k}" in values), default=0)


def slots(values: Values) -> list[Any]:
    """kappa, c1, m1, c2, m2, ..."""
    found = [values["kappa"]]
    for k in range(1, n_terms(values) + 1):
        found += [values.get(f"c{k}", 0.0), values.get(f"m{k}", 1.0)]
    return found


def exponents(derivative: Kernel) -> dict[int, tuple[Kernel, int] | None]:
    """The slots of the exponents, each with the derivative kernel of its term."""
    return {2 + 2 * k: (derivative, k) for k in range(MAX_TERMS)}


def check_terms(given: Values) -> tuple[str, str] | None:
    """Problem and fix if a modulus lacks its exponent or an exponent is 0; otherwise None."""
    for key, value in given.items():
        if key.startswith("c") and f"m{key[1:]}" not in given:
            return f"{key} without m{key[1:]}", f"give m{key[1:]}"
        if key.startswith("m") and _has_0(value):
            return f"the exponent {key} is 0", "give an exponent that is not 0"
    return None


def _has_0(value: Any) -> bool:
    """Whether a number, or any cell of a map, is 0; values of load curves are not checked."""
    if isinstance(value, ElementMap):
        return not value.values.all()
    return isinstance(value, float | int) and value == 0


def with_terms(total: Any, p: Any, number: int, squares: Any, logarithm: Any) -> Any:
    """total (n_cells, n_gauss) plus the sum of c_k/m_k^2 (sum_i s_i^(m_k/2) - 3 - m_k logarithm)."""
    for k in range(number):
        c, m = p[:, 1 + 2 * k], p[:, 2 + 2 * k]
        stretched = (squares ** (0.5 * m[..., None])).sum(-1) - 3
        total = total + c / m**2 * (stretched - m * logarithm)
    return total


def energy(p: Any, extra: int, at: Deformation) -> Any:
    """W (n_cells, n_gauss) MPa; p (n_cells, 1 + 2 n_terms, 1)."""
    return with_terms(0.5 * p[:, 0] * (at.J - 1) ** 2, p, extra, at.squares, np.log(at.J))


LAW = Law(
    "ogden",
    Kernel(add_ogden, energy, known_number=OGDEN),
    PARAMETERS,
    slots,
    exponents(Kernel(add_exponent_derivative)),
    n_terms,
    positive=("kappa",),
    check=check_terms,
    terms=True,
    febio=FebioNames("Ogden unconstrained", (("cp", "kappa"), *FEBIO_TERMS)),
)
