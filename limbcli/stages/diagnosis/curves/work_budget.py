"""Work of a site's simulations, and the budget of each, relative to that of the model without effects."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from limbcli.solvers.budget import Budget

# Budget of a candidate's simulation, as a multiple of the mean work without effects: to find the change by an
# effect; with a fitted size, whose result decides the verdict; with friction, which needs load steps.
_TIMES_USUAL, _TIMES_FITTED, _TIMES_WITH_FRICTION = 2.0, 3.0, 6.0
_LEAST_ALLOWED = 1500  # smallest budget of a candidate: some four seconds on a working mesh
# Work limit of a whole diagnosis, as a multiple of the mean work without effects; smallest mean work assumed.
_TIMES_USUAL_IN_ALL, _LEAST_USUAL = 30.0, 500.0
_FOR_MORE = 1.0  # budget of the levels beyond those needed, as a fraction of the work of the latter
# Upper limits for large or difficult models, in work times cells, of a candidate and of the whole diagnosis;
# a million takes a second and a half.
_MOST_ALLOWED, _MOST_IN_ALL = 25e6, 100e6


@dataclass
class SiteWork:
    """Work of a site's simulations, in products with a factorised matrix (see `Budget`).

    n_cells : number of cells of the model; usual : work of every solve without effects
    at_most : budget of a solve without effects; total : of all solves, including those of an earlier run
    """

    n_cells: int = 0
    usual: list[int] = field(default_factory=list)
    at_most: float = math.inf
    total: int = 0

    def of_candidate(
        self, *, has_friction: bool = False, fitted: bool = False, needed: float = 1.0
    ) -> Budget:
        """Budget of a solve with a candidate effect.

        fitted : the size of the effect is that of a fit; needed : fraction of the load steps that must be
        reached
        """
        times = _TIMES_WITH_FRICTION if has_friction else _TIMES_FITTED if fitted else _TIMES_USUAL
        limit = max(_LEAST_ALLOWED, min(times * self.mean, _MOST_ALLOWED / max(self.n_cells, 1)))
        return Budget(allowed=limit, needed=needed, beyond=_FOR_MORE)

    @property
    def mean(self) -> float:
        """Mean work of the solves without effects; 0 before the first."""
        return float(np.mean(self.usual)) if self.usual else 0.0

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Context manager in which solves are not counted.

        A diagnosis that finds the final result in the cache does not repeat the auxiliary solves within, and
        must come to the same conclusion.
        """
        known = self.total, list(self.usual)
        try:
            yield
        finally:
            self.total, self.usual = known

    @property
    def spent(self) -> bool:
        """Whether the work limit of the diagnosis is reached; further fits are then reported without
        simulations of their own."""
        usual = _TIMES_USUAL_IN_ALL * max(self.mean, _LEAST_USUAL)
        return self.total > min(usual, _MOST_IN_ALL / max(self.n_cells, 1))
