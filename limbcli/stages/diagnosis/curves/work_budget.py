"""How much work a candidate's simulation may take, by the work of the model without it.

Work is counted, not timed, so that a diagnosis says the same on any machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from limbcli.errors import SolveError

# In products of the factor: what an iteration and a factor cost beside the Krylov iterations.
_PER_ITERATION, _PER_FACTOR = 10, 20
# Of the mean work of the model without effects: to see what an effect changes, and with a fitted size, whose
# answer decides; the same with friction, which goes by steps.
_TIMES_USUAL, _TIMES_FITTED, _TIMES_WITH_FRICTION = 2.0, 3.0, 6.0
_LEAST_ALLOWED = 1500  # some four seconds on a working mesh
_TIMES_USUAL_IN_ALL, _LEAST_USUAL = 30.0, 500.0
_FOR_MORE = 1.0  # of a candidate's work on the levels that are needed: what the others may take
# Where the model itself is large or hard: products times cells, of a candidate and of all; a million take a
# second and a half.
_MOST_ALLOWED, _MOST_IN_ALL = 25e6, 100e6


@dataclass
class Work:
    """The work of one solve after another: listens to the solver's progress, and stops what takes too long.

    usual : of every solve without effects; done : of the solve that is on, or was last
    at_most : of a solve without effects; total : of all solves, those of an earlier run included
    n_cells : of the model
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
        """candidate : it has an effect in it; fitted : its size is that of a fit; needed : share of the load
        steps that must be reached"""
        self.done, self._counted = 0, (0, 0)
        self._needed = needed if candidate else math.inf
        times = _TIMES_WITH_FRICTION if has_friction else _TIMES_FITTED if fitted else _TIMES_USUAL
        limit = max(_LEAST_ALLOWED, min(times * self.mean, _MOST_ALLOWED / max(self.n_cells, 1)))
        self._allowed = limit if candidate else self.at_most

    @property
    def mean(self) -> float:
        """Of the solves without effects; 0 before the first."""
        return float(np.mean(self.usual)) if self.usual else 0.0

    def end(self) -> None:
        self._allowed = math.inf
        self.total += self.done

    @contextmanager
    def aside(self) -> Iterator[None]:
        """What is solved within is not counted: a diagnosis that finds kept what it is for does not ask
        for it again, and has to come to the same end."""
        known = self.total, list(self.usual), self.done
        try:
            yield
        finally:
            self.total, self.usual, self.done = known

    @property
    def spent(self) -> bool:
        """All that a diagnosis may take: what is left is reported without simulations of its own."""
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
