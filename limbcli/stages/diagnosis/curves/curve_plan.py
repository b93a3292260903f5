"""Range of depth of a site's curves, and solver settings of its simulations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from limbcli.stages.diagnosis.curves.site_simulations import SiteSimulations


@dataclass(frozen=True, kw_only=True)
class Reach:
    """How far to simulate curves.

    needed : mm, the depth to be reached; deeper levels are tried briefly, at m 4 only. None: all depths
    enough : fraction of this depth that must be reached by the solver
    enough_force : N (at the simulations' c), larger than any reading: the simulation ends at the first level
        with this force
    """

    needed: float | None = None
    enough: float = 0.7
    enough_force: float | None = None

    def down_to(self, depths: Sequence[float], *, share: float) -> int:
        """Number of depths (mm) down to this share of the depth needed."""
        needed = depths[-1] if self.needed is None else self.needed
        return min(int(np.searchsorted(depths, share * needed - 1e-9)) + 1, len(depths))


@dataclass(frozen=True, kw_only=True)
class Solving:
    """Solver settings of a simulation.

    tolerance : of the residual relative to the forces. That of 1e-3 changes forces by 3e-4; 1e-4 takes up to
        six times as long at folds
    threads : of the linear solver; penalty : of the contact; None: four times that of the usual model
    beside : simulations of the same depths on another mesh. Its levels are initial guesses, and curves are
        extrapolated along its curves where the solver stops
    """

    tolerance: float = 1e-3
    threads: int = 2
    penalty: float | None = None
    beside: SiteSimulations | None = None
