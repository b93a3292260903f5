"""Where the numbers of sixteen points stand: rows of one flat array (see `simd`)."""

from __future__ import annotations

import numpy as np
from numba import njit

from limbcli.materials.simd import LANES

F, J, C, D, S, CC = 0, 9, 10, 16, 22, 28  # 9, 1, 6, 6, 6, 21 (the upper triangle, row by row)
ALPHA, BETA, X = 49, 50, 51  # 1, 1, 6
PLUS, MINUS, KAPPA = 57, 58, 59
SQUARES, LOGS, VECTORS, TAU, SLOPES, QUOTIENTS = 60, 63, 66, 75, 78, 81  # 3, 3, 9, 3, 3, 3
P, H = 84, 102  # 18, 6
WEIGHT, SHIFT = 108, 109
STRESS, TANGENT, PRODUCTS = 110, 119, 173  # of the element loops: 9, 54, 54
N_ROWS = 227

UPPER = np.zeros((6, 6), dtype=np.int64)  # row of the tangent's upper triangle
UPPER[np.triu_indices(6)] = np.arange(21)
UPPER += np.triu(UPPER, 1).T


@njit(cache=True, error_model="numpy")
def room():
    """The rows, and what point-by-point laws need."""
    return np.zeros(N_ROWS * LANES), np.empty((3, 3)), np.empty(6), np.empty((6, 6))
