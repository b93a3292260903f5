"""The memory of a factor, allocated once and reused."""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.fem.linear_solvers.multifrontal import blas
from limbcli.fem.linear_solvers.multifrontal.compact_factor import make_kept
from limbcli.fem.linear_solvers.multifrontal.dense import ALIGNED, STRIP, TILE
from limbcli.fem.linear_solvers.multifrontal.plan import Layout

BLOCK = 192  # columns per block of a front factored by two threads
# Size below which a pivot of the scaled matrix is perturbed, in single (True) and double (False) precision.
_TINY = {True: 1e-6, False: 1e-8}


class Store:
    """Arrays in the factor's precision.

    kept : the factor, without the last front
    panels : pivot columns of a front, for each of two threads; updates : update matrices (see `Plan`)
    values : the scaled matrix; scaling (n,) : scale factors by equation number
    sign (n,) : signs of the pivots, in elimination order
    work, inverses : workspace for each of two threads
    """

    def __init__(self, layout: Layout, n: int, n_values: int, single: bool):
        self.kind: Any = np.float32 if single else np.float64
        self.plan = layout.plan
        self.blas = blas.addresses(single)
        self.tiny = self.kind(_TINY[single])
        plan = layout.plan
        self.kept = make_kept(n, int(plan.tile_at[-2]), int(plan.part_at[-2]), self.kind)
        workspace = layout.panel_size + ALIGNED  # vector instructions may read beyond the last column
        self.panels = [np.empty(workspace, dtype=self.kind) for _ in range(2)]
        self.updates = np.empty(layout.update_size, dtype=self.kind)
        self.values = np.empty(n_values, dtype=self.kind)
        self.sign = np.ones(n, dtype=self.kind)
        self.scaling = np.ones(n)
        workspace = max(BLOCK * max(layout.largest_panel, BLOCK), TILE * STRIP) + TILE * TILE
        self.work = [np.empty(workspace, dtype=self.kind) for _ in range(2)]
        self.inverses = [np.empty((BLOCK + TILE) * TILE, dtype=self.kind) for _ in range(2)]
