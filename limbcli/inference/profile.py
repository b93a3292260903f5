"""Profile likelihoods: the deviance of one parameter's values with the other parameters refitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.errors import FitError, SolveError
from limbcli.inference.least_squares import Fit, least_squares_fit
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Objective, Residual
from limbcli.model import Array
from limbcli.numbers.interval_limits import THRESHOLD_95

_TIGHT = 1e-4  # tolerance of the fits
_CLOSE = 0.02  # tolerance of the deviance at an interval's end
_FEWEST = 6  # smallest number of points on one side of the best fit
_N_POINTS = 31  # points between the bounds of a parameter, in its logarithm
Point = tuple[float, float, Array]  # x, deviance, theta; x : ln of a parameter, or another quantity
Held = Callable[[float, Array], tuple[float, Array]]


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile likelihood of one parameter.

    values, deviance : (n,) increasing, and decrease of twice the log likelihood from its maximum
    thetas : (n, n_parameters) refitted at the values; ends : (2, n_parameters) at low and at high
    open_low, open_high : the profile is below the threshold at that bound: the data exclude nothing on that
        side
    """

    name: str
    values: Array
    deviance: Array
    thetas: Array
    low: float
    high: float
    open_low: bool
    open_high: bool
    ends: Array

    @property
    def is_open(self) -> bool:
        return self.open_low or self.open_high

    @property
    def limits(self) -> tuple[float | None, float | None]:
        """low and high; None where the interval is open."""
        return None if self.open_low else self.low, None if self.open_high else self.high

    def root_at(self, values: Array) -> Array:
        """Root of the deviance (nearly linear in ln of the parameter); infinite beyond the profile."""
        root = np.sqrt(np.maximum(self.deviance, 0.0))
        return np.asarray(np.interp(np.log(values), np.log(self.values), root, left=np.inf, right=np.inf))

    def ends_beyond(self, limit: float) -> bool:
        """Whether an end, extended to include another fit, lies where the curve is above the limit, or beyond
        it."""
        return bool((self.root_at(np.array([self.low, self.high])) ** 2 > limit + 2 * _CLOSE).any())


def best_of(objective: Objective, parameters: Sequence[FitParameter], starts: Sequence[Array]) -> Fit:
    """The fit with the lowest cost from the starts that can be solved; FitError if none leads to a fit."""
    fits = []
    for start in starts:
        started = [p.in_logs().started_at(float(t)) for p, t in zip(parameters, start, strict=True)]
        try:
            fits.append(
                least_squares_fit(objective, started, tolerance=_TIGHT, max_iterations=100, must_settle=False)
            )
        except (FitError, SolveError):
            continue
    if not fits:
        raise FitError(
            f"none of {len(starts)} starts led to a fit",
            where=", ".join(p.name for p in parameters),
            fix="check the measurement (force-depth.png of `limbcli run`) and the noise in case.toml",
        )
    return min(fits, key=lambda fit: fit.cost)


def profile_likelihood(
    objective: Objective, parameters: Sequence[FitParameter], best: Fit, index: int, *,
    threshold: float = THRESHOLD_95, scale: float = 1.0,
) -> Profile:  # fmt: skip
    """Profile likelihood of parameter `index`, followed outwards from the best fit to its bounds.

    objective : residuals in standard deviations, so that its cost is chi-square
    scale : the deviance is divided by it (chi-square per degree of freedom where the data scatter more than
        stated)
    threshold : deviance at the ends; the 95 % quantile of chi-square, or `threshold_95`

    Source: Venzon and Moolgavkar 1988, Appl. Stat. 37:87; Raue et al. 2009, Bioinformatics 25:1923.
    """
    others = [k for k in range(len(parameters)) if k != index]

    def at(x: float, guess: Array) -> tuple[float, Array]:
        """(deviance, theta) with this parameter held at exp(x) and the others refitted."""
        value = float(np.exp(x))

        def held(part: Array, derivative: bool = True) -> Residual:
            theta = np.insert(part, index, value)
            full = objective(theta, derivative)
            return Residual(full.values, None if full.jacobian is None else full.jacobian[:, others])

        if not others:
            return (objective(np.array([value]), False).cost - best.cost) / scale, np.array([value])
        fit = best_of(held, [parameters[k] for k in others], [guess[others]])
        return (fit.cost - best.cost) / scale, np.insert(fit.theta, index, value)

    low, start, high = np.log([parameters[index].low, best.theta[index], parameters[index].high])
    middle = (float(start), 0.0, best.theta)
    sides = []
    for stop in (low, high):
        n = int(np.ceil(abs(stop - start) * _N_POINTS / (high - low)))
        side = walk(at, middle, np.linspace(start, stop, n + 1)[1:], threshold)
        sides.append(replace(side, points=_filled(at, middle, side.points)))
    down, up = sides
    points = [*reversed(down.points), middle, *up.points]
    ends = [float(np.clip(np.exp(each.end), parameters[index].low, parameters[index].high)) for each in sides]
    return Profile(
        parameters[index].name, np.exp([x for x, _, _ in points]), np.array([each for _, each, _ in points]),
        np.array([theta for _, _, theta in points]), ends[0], ends[1], down.is_open, up.is_open,
        np.array([down.theta, up.theta]),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Side:
    """A walk outwards: its points, its end with theta there, and whether the data exclude nothing."""

    points: list[Point]
    end: float
    theta: Array
    is_open: bool


def walk(at: Held, start: Point, grid: Array, threshold: float) -> Side:
    """Follow the deviance from the best fit along the grid (n,) until it exceeds the threshold, then locate
    the crossing; at : (x, a theta nearby) -> (deviance, theta) with the quantity held at x, infinite, where
    the walk ends, if no parameters within their bounds give x"""
    points: list[Point] = []
    inside = start
    for x in grid.tolist():
        here = (x, *at(x, inside[2]))
        if not np.isfinite(here[1]):
            break
        if here[1] > threshold:
            more = _crossing(at, inside, here, threshold)
            points = sorted([*points, *more], key=lambda point: abs(point[0] - start[0]))
            return Side(points, more[-1][0], more[-1][2], False)
        points.append(here)
        inside = here
    return Side(points, inside[0], inside[2], True)


def _crossing(at: Held, inside: Point, outside: Point, threshold: float) -> list[Point]:
    """Points up to where the deviance reaches the threshold, by secants of its nearly linear root."""
    found: list[Point] = []
    for _ in range(12):
        low, high = (np.sqrt(max(point[1], 0.0)) for point in (inside, outside))
        share = min(max((np.sqrt(threshold) - low) / (high - low), 0.1), 0.9)
        x = float(inside[0] + share * (outside[0] - inside[0]))
        found.append((x, *at(x, inside[2])))
        if abs(found[-1][1] - threshold) < _CLOSE or abs(outside[0] - inside[0]) < 1e-3:
            break
        if found[-1][1] > threshold:
            outside = found[-1]
        else:
            inside = found[-1]
    return found


def _filled(at: Held, start: Point, points: list[Point]) -> list[Point]:
    """Replace the points of a short side by enough points for a smooth curve."""
    if not points or len(points) >= _FEWEST:
        return points
    more: list[Point] = []
    for share in np.arange(1, _FEWEST) / _FEWEST:
        x = float(start[0] + share * (points[-1][0] - start[0]))
        more.append((x, *at(x, more[-1][2] if more else start[2])))
    return [*more, points[-1]]
