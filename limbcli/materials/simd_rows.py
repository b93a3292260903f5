"""Layout of the data of sixteen integration points: named rows of one flat array (see `simd`)."""

from __future__ import annotations

import numpy as np

from limbcli.materials.simd import LANES
from limbcli.numbers.compiled import njit

_SIZES = {
    "F": 9, "J": 1, "C": 6, "D": 6, "S": 6, "CC": 21,  # the tangent: its upper triangle, row by row
    "ALPHA": 1, "BETA": 1, "X": 6, "PLUS": 1, "MINUS": 1, "KAPPA": 1,
    "SQUARES": 3, "LOGS": 3, "VECTORS": 9, "TAU": 3, "SLOPES": 3, "QUOTIENTS": 3, "P": 18, "H": 6,
    "WEIGHT": 1, "SHIFT": 1, "STRESS": 9, "TANGENT": 54, "PRODUCTS": 54,  # of the element loops
}  # fmt: skip
N_ROWS = sum(_SIZES.values())
_FIRST = {name: sum(list(_SIZES.values())[:k]) for k, name in enumerate(_SIZES)}
F, J, C, D, S, CC = (_FIRST[name] for name in ("F", "J", "C", "D", "S", "CC"))
ALPHA, BETA, X, PLUS, MINUS, KAPPA = (_FIRST[n] for n in ("ALPHA", "BETA", "X", "PLUS", "MINUS", "KAPPA"))
SQUARES, LOGS, VECTORS, TAU = (_FIRST[name] for name in ("SQUARES", "LOGS", "VECTORS", "TAU"))
SLOPES, QUOTIENTS, P, H = (_FIRST[name] for name in ("SLOPES", "QUOTIENTS", "P", "H"))
WEIGHT, SHIFT, STRESS = (_FIRST[name] for name in ("WEIGHT", "SHIFT", "STRESS"))
TANGENT, PRODUCTS = _FIRST["TANGENT"], _FIRST["PRODUCTS"]

UPPER = np.zeros((6, 6), dtype=np.int64)  # index of tangent entry (p, q) in the upper triangle
UPPER[np.triu_indices(6)] = np.arange(21)
UPPER += np.triu(UPPER, 1).T


@njit
def simd_workspace():
    """The rows, and the arrays F, S and CC of a single point for laws evaluated point by point."""
    return np.zeros(N_ROWS * LANES), np.empty((3, 3)), np.empty(6), np.empty((6, 6))
