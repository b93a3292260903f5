"""The soft side of a contact."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from limbcli.model import Array, IntArray


@dataclass(eq=False)
class Patch:
    """Soft facets of one kind with their integration points.

    N, dN, weights : shape functions, their derivatives, and weights of the integration rule
    group, cell : cell group behind each facet, and the cell's row in it
    areas (mm^2), ratio (facet area over volume of the cell behind, 1/mm), normals (unit, where both natural
        coordinates are 0) : reference configuration
    eps (n_facets,) : penalty, MPa/mm; multiplier (n_facets, n_gauss) : of augmented contact, MPa
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
    pairs: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int32))
