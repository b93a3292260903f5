"""Work budget of a candidate's simulation, relative to the work of the model without the candidate.

Work is counted in solver operations, not in time, so that a diagnosis gives the same result on any machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from limbcli.errors import SolveError

# The unit of work is one product with the factorised matrix, as in a Krylov iteration. Further work of a
# Newton iteration and of a factorisation, in this unit.
_PER_ITERATION, _PER_FACTOR = 10, 20
# Work limit of a candidate's simulation, as a multiple of the mean work without effects: to find the change
# by an effect; with a fitted size, whose result decides the verdict; with friction, which needs load steps.
_TIMES_USUAL, _TIMES_FITTED, _TIMES_WITH_FRICTION = 2.0, 3.0, 6.0
_LEAST_ALLOWED = 1500  # smallest work limit of a candidate: some four seconds on a working mesh
# Work limit of a whole diagnosis, as a multiple of the mean work without effects; smallest mean work assumed.
_TIMES_USUAL_IN_ALL, _LEAST_USUAL = 30.0, 500.0
_FOR_MORE = 1.0  # work limit of the levels beyond those needed, as a fraction of the work of the latter
# Upper limits for large or difficult models, in work times cells, of a candidate and of the whole diagnosis;
# a million takes a second and a half.
_MOST_ALLOWED, _MOST_IN_ALL = 25e6, 100e6


@dataclass
class Work:
    """Work counter of successive solves: listens to the solver's progress and stops solves over their limit.

    usual : work of every solve without effects; done : work of the current or last solve
    at_most : work limit of a solve without effects; total : of all solves, including those of an earlier run
    n_cells : number of cells of the model
    """

    n_cells: int = 0
    usual: list[int] = field(default_factory=list)
    at_most: float = math.inf
    total: int = 0
    done: int = 0
    _allowed: float = math.inf
    _counted: tuple[int, int] = (0, 0)
    _needed: float = math.inf

    def begin(
        self, *, candidate: bool, has_friction: bool = False, fitted: bool = False, needed: float = 1.0
    ) -> None:
        """Start counting a new solve and set its work limit.

        candidate : the model includes a candidate effect; fitted : the size of the effect is that of a fit
        needed : fraction of the load steps that must be reached
        """
        self.done, self._counted = 0, (0, 0)
        self._needed = needed if candidate else math.inf
        times = _TIMES_WITH_FRICTION if has_friction else _TIMES_FITTED if fitted else _TIMES_USUAL
        limit = max(_LEAST_ALLOWED, min(times * self.mean, _MOST_ALLOWED / max(self.n_cells, 1)))
        self._allowed = limit if candidate else self.at_most

    @property
    def mean(self) -> float:
        """Mean work of the solves without effects; 0 before the first."""
        return float(np.mean(self.usual)) if self.usual else 0.0

    def end(self) -> None:
        self._allowed = math.inf
        self.total += self.done

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Context manager in which solves are not counted.

        A diagnosis that finds the final result in the cache does not repeat the auxiliary solves within, and
        must come to the same conclusion.
        """
        known = self.total, list(self.usual), self.done
        try:
            yield
        finally:
            self.total, self.usual, self.done = known

    @property
    def spent(self) -> bool:
        """Whether the work limit of the diagnosis is reached; further fits are then reported without
        simulations of their own."""
        usual = _TIMES_USUAL_IN_ALL * max(self.mean, _LEAST_USUAL)
        return self.total > min(usual, _MOST_IN_ALL / max(self.n_cells, 1))

    def __call__(self, kind: str, facts: dict[str, Any]) -> None:
        if kind != "newton":
            return
        counts = int(facts.get("krylov", 0)), int(facts.get("factorisations", 0))
        krylov, factors = (
            now - before if now >= before else now for now, before in zip(counts, self._counted, strict=True)
        )
        self._counted = counts
        if facts.get("step", 0) > self._needed * facts.get("n_steps", math.inf):
            self._needed, self._allowed = math.inf, min(self._allowed, (1.0 + _FOR_MORE) * self.done)
        self.done += _PER_ITERATION + krylov + _PER_FACTOR * factors
        if self.done > self._allowed:
            raise SolveError(
                "it requires several times the work of the model without it",
                where="diagnose", fix="run the written model separately",
            )  # fmt: skip
