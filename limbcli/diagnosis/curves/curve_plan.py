"""What is simulated for a site's curves: exponents of the law, range of depth, and how much work.

The dependence of force and speed on the exponent is given by `bend`.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from limbcli.errors import LimbError, SolveError
from limbcli.solvers.session_options import Budget

if TYPE_CHECKING:
    from limbcli.diagnosis.curves.site_simulations import SiteSimulations

S = TypeVar("S")
T = TypeVar("T")
# Exponents m that are simulated first at every site; values between are interpolated, others are simulated
# when needed. The stiffer law stays stable to larger depths, and its solutions are initial guesses for the
# softer ones.
FIRST_M, USUAL_M = (8.0, 4.0), 4.0
_BEND = 8.0  # m around which the dependence changes from quadratic to exponential
# Budget of a candidate's simulation, as a multiple of the mean work without effects: to find the change by an
# effect; with a fitted size, whose result decides the verdict; with friction, which needs load steps.
_TIMES_USUAL, _TIMES_FITTED, _TIMES_WITH_FRICTION = 2.0, 3.0, 6.0
_LEAST_ALLOWED = 1500  # smallest budget of a candidate: some four seconds on a working mesh
# Work limit of a whole diagnosis, as a multiple of the mean work without effects; smallest mean work assumed.
_TIMES_USUAL_IN_ALL, _LEAST_USUAL = 30.0, 500.0
# Depths at which models with effects are solved, as fractions of the depth needed: what an effect changes is
# smooth. Interpolated between them, it missed the force by 0.0014 of the largest one (median of 100 solves of
# ten sites; 0.011 at most) and ln speed by 0.0025 (root mean square).
_SHARES = (1 / 6, 1 / 2, 5 / 6, 1.0)
_FOR_MORE = 1.0  # budget of the levels beyond those needed, as a fraction of the work of the latter
# Upper limits for large or difficult models, in work times cells, of a candidate and of the whole diagnosis;
# a million takes a second and a half.
_MOST_ALLOWED, _MOST_IN_ALL = 25e6, 100e6


def bend(m: Any) -> Any:
    """Transform of m in which ln force and ln speed are smooth: the law is even in m, and exponential for
    large m. Polynomials in it through m 2, 5, 10 are within 0.3 % from 1 to 9; in ln m within 80 %."""
    return np.sqrt(_BEND**2 + np.square(m))


def nearest_m(several: Iterable[float], m: float) -> float:
    """
    >>> nearest_m((8.0, 4.0), 5.0)
    4.0
    """
    return min(several, key=lambda each: abs(np.log(each / m)))


def where_solved(of: Callable[[float], T], several: Iterable[float]) -> dict[float, T]:
    """What a function that simulates gives at these m, without those at which it raises SolveError."""
    found: dict[float, T] = {}
    for m in several:
        with contextlib.suppress(SolveError):
            found[m] = of(m)
    return found


def some_solved(
    of: Callable[[S], T], several: Iterable[S], *, unless: type[LimbError] = SolveError
) -> list[T]:
    """What a function gives for these, without those for which it fails; raises if it fails for all."""
    found, problem = [], None
    for each in several:
        try:
            found.append(of(each))
        except unless as error:
            problem = error
    if not found and problem is not None:
        raise problem
    return found


@dataclass(frozen=True, kw_only=True)
class Reach:
    """How far to simulate curves.

    needed : mm, the depth to be reached (None: all); deeper levels are tried briefly, at m 4 only
    enough : fraction of this depth that must be reached by the solver; enough_force : N (at the simulations'
        c), larger than any reading, at which the simulation ends
    """

    needed: float | None = None
    enough: float = 0.7
    enough_force: float | None = None

    def down_to(self, depths: Sequence[float], *, share: float) -> int:
        """Number of depths (mm) down to this share of the depth needed."""
        return min(int(np.searchsorted(depths, share * self._needed(depths) - 1e-9)) + 1, len(depths))

    def few(self, depths: Sequence[float]) -> list[float]:
        """Those of the depths (mm) at which a smooth difference from known curves is solved.

        >>> Reach(needed=6.0).few([0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
        [1.0, 3.0, 5.0, 6.0]
        """
        return sorted({min(depths, key=lambda d: abs(d - share * self._needed(depths))) for share in _SHARES})

    def _needed(self, depths: Sequence[float]) -> float:
        return depths[-1] if self.needed is None else self.needed


@dataclass(frozen=True, kw_only=True)
class Solving:
    """Solver settings of a simulation.

    tolerance : of the residual relative to the forces. That of 1e-3 changes forces by 3e-4; 1e-4 takes up to
        six times as long at folds
    penalty : of the contact; None: four times that of the usual model
    beside : simulations of the same depths on another mesh, whose levels are initial guesses, and along whose
        curves those without effects are extrapolated
    """

    tolerance: float = 1e-3
    threads: int = 2
    penalty: float | None = None
    beside: SiteSimulations | None = None


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
        """Budget of a solve with a candidate effect, with a size of a fit (`fitted`) or of the first
        estimate; needed : fraction of the load steps that must be reached"""
        times = _TIMES_WITH_FRICTION if has_friction else _TIMES_FITTED if fitted else _TIMES_USUAL
        limit = max(_LEAST_ALLOWED, min(times * self.mean, _MOST_ALLOWED / max(self.n_cells, 1)))
        return Budget(allowed=limit, needed=needed, beyond=_FOR_MORE)

    @property
    def mean(self) -> float:
        """Mean work of the solves without effects; 0 before the first."""
        return float(np.mean(self.usual)) if self.usual else 0.0

    @contextlib.contextmanager
    def aside(self) -> Iterator[None]:
        """Context manager in which solves are not counted: a diagnosis that finds the final result in the
        cache does not repeat these auxiliary solves, and must come to the same conclusion."""
        known = self.total, list(self.usual)
        try:
            yield
        finally:
            self.total, self.usual = known

    @property
    def spent(self) -> bool:
        """Whether the work limit of the diagnosis is reached: further fits are then not simulated."""
        usual = _TIMES_USUAL_IN_ALL * max(self.mean, _LEAST_USUAL)
        return self.total > min(usual, _MOST_IN_ALL / max(self.n_cells, 1))
