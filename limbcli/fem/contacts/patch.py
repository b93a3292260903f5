"""The soft side of a contact."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array, IntArray


@dataclass(eq=False)
class Patch:
    """Soft facets of one kind with their integration points.

    group, cell : the group of cells behind each facet, and the cell's row in it
    areas (mm^2), ratio (area over volume behind, 1/mm), normals : of the reference state
    """

    facets: IntArray
    N: Array
    dN: Array
    weights: Array
    group: IntArray
    cell: IntArray
    areas: Array
    ratio: Array
    normals: Array
    eps: Array
    multiplier: Array
    state: Array
    pairs: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int32))
