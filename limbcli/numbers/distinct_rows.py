"""The distinct rows of a table, for millions of rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def distinct_rows(rows: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where each distinct row (n, k) stands first, in their ascending order; and the number (n,) of every row
    among them.

    As numpy.unique(axis=0) finds them, which compares whole rows and takes five times as long.

    >>> first, number = distinct_rows(np.array([[2, 1], [0, 5], [2, 1], [0, 4]]))
    >>> first.tolist(), number.tolist()
    ([3, 1, 0], [2, 1, 2, 0])
    """
    order = np.lexsort(rows.T[::-1])  # stable
    ascending = rows[order]
    is_new = np.ones(len(rows), bool)
    is_new[1:] = (ascending[1:] != ascending[:-1]).any(axis=1)
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(is_new) - 1
    return order[is_new], number
