"""Partition of a group's cells between two threads that add to one array of blocks without conflicts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array, IntArray


@dataclass(frozen=True, eq=False)
class Halves:
    """The cells of a group ordered so that the two halves share few node pairs.

    order (n_cells,) : cell numbers, sorted along the longest axis
    pairs (n_cells, n_nodes (n_nodes + 1) / 2) : codes as in `assembly.Pattern`, except that pairs of the
        second half that also occur in the first get separate numbers, from n_pairs on
    shared : the original numbers of these pairs, in order
    """

    order: IntArray
    pairs: NDArray[np.int32]
    shared: IntArray


def halve(middles: Array, pairs: NDArray[np.int32], n_pairs: int) -> Halves:
    """Halve the cells with centroids `middles` (n_cells, 3) and codes `pairs` along the longest axis."""
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
