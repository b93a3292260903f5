"""Small symmetric tensors inside compiled kernels.

Symmetric tensors are six numbers in the order xx, yy, zz, xy, yz, xz (tensor
components, no factor 2 on the shears). A tangent CC is 6x6 with
CC[IJ, KL] = dS_IJ / dE_KL in tensor components, so that dS = sum over all nine KL.
"""

from __future__ import annotations

import numpy as np

from limbcli.numbers.compiled import njit

# index of component (i, j) among the six
VOIGT = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]], dtype=np.int64)
FIRST = np.array([0, 1, 2, 0, 1, 0], dtype=np.int64)
SECOND = np.array([0, 1, 2, 1, 2, 2], dtype=np.int64)


@njit(forceinline=True)
def determinant(F):
    return (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        - F[0, 1] * (F[1, 0] * F[2, 2] - F[1, 2] * F[2, 0])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


@njit
def right_cauchy_green(F, C):
    """C = F'F into C (6)."""
    a, b, c = F[0, 0], F[0, 1], F[0, 2]
    d, e, f = F[1, 0], F[1, 1], F[1, 2]
    g, h, i = F[2, 0], F[2, 1], F[2, 2]
    C[0] = a * a + d * d + g * g
    C[1] = b * b + e * e + h * h
    C[2] = c * c + f * f + i * i
    C[3] = a * b + d * e + g * h
    C[4] = b * c + e * f + h * i
    C[5] = a * c + d * f + g * i


@njit
def inverse6(C, D):
    """Inverse of a symmetric tensor of six numbers into D."""
    a, b, c, d, e, f = C[0], C[1], C[2], C[3], C[4], C[5]
    x, y, z = b * c - e * e, e * f - d * c, d * e - b * f
    part = 1.0 / (a * x + d * y + f * z)
    D[0] = x * part
    D[1] = (a * c - f * f) * part
    D[2] = (a * b - d * d) * part
    D[3] = y * part
    D[4] = (d * f - a * e) * part
    D[5] = z * part


@njit
def square6(A, B):
    """B = A A, symmetric tensors of six numbers."""
    a, b, c, d, e, f = A[0], A[1], A[2], A[3], A[4], A[5]
    B[0] = a * a + d * d + f * f
    B[1] = d * d + b * b + e * e
    B[2] = f * f + e * e + c * c
    B[3] = a * d + d * b + f * e
    B[4] = d * f + b * e + e * c
    B[5] = a * f + d * e + f * c


@njit
def _rotation(app, aqq, apq):
    """Tangent, cosine and sine of the Jacobi rotation that makes the off-diagonal apq vanish."""
    theta = 0.5 * (aqq - app) / apq
    t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
    if theta < 0.0:
        t = -t
    c = 1.0 / np.sqrt(t * t + 1.0)
    return t, c, t * c


@njit
def _turn(vectors, p, q, c, s):
    """Rotate columns p and q of the eigenvectors."""
    for k in range(3):
        x, y = vectors[k, p], vectors[k, q]
        vectors[k, p] = c * x - s * y
        vectors[k, q] = s * x + c * y


@njit
def eigen6(C, values, vectors):
    """Eigenvalues and orthonormal eigenvectors (columns) of a symmetric tensor.

    Cyclic Jacobi method: slower than the closed form, but the vectors are orthonormal
    to round-off even for very close eigenvalues.
    """
    a00, a11, a22, a01, a12, a02 = C[0], C[1], C[2], C[3], C[4], C[5]
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
    scale = (abs(a00) + abs(a11) + abs(a22)) * 1e-17
    for _ in range(12):
        if abs(a01) + abs(a02) + abs(a12) <= scale:
            break
        if abs(a01) > 0.0:
            t, c, s = _rotation(a00, a11, a01)
            a00, a11, a01 = a00 - t * a01, a11 + t * a01, 0.0
            a02, a12 = c * a02 - s * a12, s * a02 + c * a12
            _turn(vectors, 0, 1, c, s)
        if abs(a02) > 0.0:
            t, c, s = _rotation(a00, a22, a02)
            a00, a22, a02 = a00 - t * a02, a22 + t * a02, 0.0
            a01, a12 = c * a01 - s * a12, s * a01 + c * a12
            _turn(vectors, 0, 2, c, s)
        if abs(a12) > 0.0:
            t, c, s = _rotation(a11, a22, a12)
            a11, a22, a12 = a11 - t * a12, a22 + t * a12, 0.0
            a01, a02 = c * a01 - s * a02, s * a01 + c * a02
            _turn(vectors, 1, 2, c, s)
    values[0], values[1], values[2] = a00, a11, a22


@njit
def add_outer(CC, factor, a, b):
    """CC += factor a (x) b."""
    for p in range(6):
        for q in range(6):
            CC[p, q] += factor * a[p] * b[q]


@njit
def add_square(CC, factor, A):
    """CC += factor times the symmetric square A (.) A: 1/2 (A_IK A_JL + A_IL A_JK)."""
    for p in range(6):
        i, j = FIRST[p], SECOND[p]
        for q in range(6):
            k, l = FIRST[q], SECOND[q]
            CC[p, q] += 0.5 * factor * (A[VOIGT[i, k]] * A[VOIGT[j, l]] + A[VOIGT[i, l]] * A[VOIGT[j, k]])
