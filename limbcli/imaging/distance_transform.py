"""Exact Euclidean distance of voxels to a mask."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array
from limbcli.numbers.compiled import njit


def distance_to(mask: NDArray[np.bool_], spacing: Array) -> Array:
    """Distance of every voxel to the nearest one of a mask, mm; inf if the mask is empty.

    One axis after the other: the nearest voxel along a line of the first axis is known from two scans; along
    each further axis, the squared distance is the lower envelope of parabolas over the voxels (Felzenszwalb
    and Huttenlocher 2012, Theory of Computing 8:415).

    mask : two or three axes
    spacing : of the voxels along each of them, mm

    >>> distance_to(np.array([[True, False, False], [False, False, False]]), np.array([3.0, 2.0]))
    array([[0.        , 2.        , 4.        ],
           [3.        , 3.60555128, 5.        ]])
    """
    shape = (*mask.shape, 1)[:3]
    a, b, c = (*(float(each) for each in spacing), 1.0)[:3]
    return np.asarray(_distance_to(np.ascontiguousarray(mask).reshape(shape), a, b, c)).reshape(mask.shape)


@njit
def _distance_to(mask: Any, a: float, b: float, c: float) -> Any:
    n_i, n_j, n_k = mask.shape
    squared = np.full(mask.shape, np.inf)
    last = np.full((n_j, n_k), -1, np.int64)
    for direction in (1, -1):
        last[:] = -1
        for step in range(n_i):
            i = step if direction == 1 else n_i - 1 - step
            for j in range(n_j):
                for k in range(n_k):
                    if mask[i, j, k]:
                        last[j, k] = i
                    if last[j, k] >= 0:
                        away = a * (i - last[j, k])
                        squared[i, j, k] = min(squared[i, j, k], away * away)
    longest = max(n_j, n_k)
    at, value = np.empty(longest, np.int64), np.empty(longest)
    start = np.empty(longest + 1)
    for i in range(n_i):
        if n_j > 1:
            for k in range(n_k):
                _along(squared[i, :, k], b, at, value, start)
        if n_k > 1:
            for j in range(n_j):
                _along(squared[i, j], c, at, value, start)
    return np.sqrt(squared)


@njit
def _along(squared: Any, step: float, at: Any, value: Any, start: Any) -> None:
    """Squared distances along a line, in place: the lowest of the parabolas over its samples.

    at, value : of the parabolas of the envelope; start : where each begins to be the lowest, in samples
    """
    n, n_low = len(squared), 0
    for j in range(n):
        f = squared[j]
        if f == np.inf:
            continue
        begin = -np.inf
        while n_low:
            before = n_low - 1
            apart = j - at[before]
            begin = 0.5 * (j + at[before]) + 0.5 * (f - value[before]) / (step * step * apart)
            if begin > start[before]:
                break
            n_low = before
            begin = -np.inf
        at[n_low], value[n_low], start[n_low] = j, f, begin
        n_low += 1
    if not n_low:
        return
    start[n_low] = np.inf
    lowest = 0
    for j in range(n):
        while start[lowest + 1] < j:
            lowest += 1
        away = step * (j - at[lowest])
        squared[j] = value[lowest] + away * away
