"""Two threads that add to one array of blocks: which cells each takes, and what both would add to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array, IntArray


@dataclass(frozen=True, eq=False)
class Halves:
    """The cells of a group in an order whose two halves have few pairs of nodes in common.

    order (n_cells,) : numbers of the cells, cut by a plane through the middle
    pairs (n_cells, n_nodes (n_nodes + 1) / 2) : as in `assembly.Pattern`, but the second half's that the
        first half has too are numbered on their own, from n_pairs on
    shared : the pairs that these stand for
    """

    order: IntArray
    pairs: NDArray[np.int32]
    shared: IntArray


def halve(middles: Array, pairs: NDArray[np.int32], n_pairs: int) -> Halves:
    """Cells at `middles` (n_cells, 3), with codes `pairs`, cut across the longest axis."""
    axis = int(np.argmax(np.ptp(middles, axis=0))) if len(middles) else 0
    order = np.argsort(middles[:, axis], kind="stable")
    cut = len(order) // 2
    numbers = pairs // 2
    mine = np.zeros(n_pairs, dtype=bool)
    mine[numbers[order[:cut]].ravel()] = True
    others = np.zeros(n_pairs, dtype=bool)
    others[numbers[order[cut:]].ravel()] = True
    shared = np.flatnonzero(mine & others)
    number = np.arange(n_pairs)
    number[shared] = n_pairs + np.arange(len(shared))
    codes = pairs.copy()
    second = order[cut:]
    codes[second] = 2 * number[numbers[second]] + pairs[second] % 2
    return Halves(order, codes, shared)
