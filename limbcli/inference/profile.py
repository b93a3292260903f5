"""Profile likelihoods: the deviance of one parameter's values with the other parameters refitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.errors import FitError, SolveError
from limbcli.inference.least_squares import Fit, least_squares_fit
from limbcli.inference.parameter import FitParameter
from limbcli.inference.residual import Objective, Residual
from limbcli.model import Array
from limbcli.numbers.interval_limits import THRESHOLD_95

_TIGHT = 1e-4  # tolerance of the fits
_CLOSE = 0.02  # tolerance of the deviance at an interval's end
_FEWEST = 6  # smallest number of points on one side of the best fit
_Point = tuple[float, float, Array]  # value, deviance, theta


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile likelihood of one parameter.

    values : (n,) increasing
    deviance : (n,) decrease of twice the log likelihood from its maximum
    thetas : (n, n_parameters) refitted parameters at the values
    low, high : ends of the interval
    open_low, open_high : the profile is still below the threshold at that bound, so the data exclude nothing
        on that side
    ends : (2, n_parameters) theta at low and at high
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


def ends_beyond(profile: Profile, limit: float) -> bool:
    """Whether an end of the interval lies where the curve is above the limit, or beyond the curve.

    This is so where the interval was extended to include a fit by another method.
    """
    ends = np.array([profile.low, profile.high])
    root = np.sqrt(np.maximum(profile.deviance, 0.0))
    at = np.interp(np.log(ends), np.log(profile.values), root, left=np.inf, right=np.inf) ** 2
    return bool((at > limit + 2 * _CLOSE).any())


def best_of(objective: Objective, parameters: Sequence[FitParameter], starts: Sequence[Array]) -> Fit:
    """The fit with the lowest cost from several starts; starts that cannot be solved are skipped.

    Raises
    ------
    FitError
        If no start leads to a fit.
    """
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
    objective: Objective,
    parameters: Sequence[FitParameter],
    best: Fit,
    index: int,
    *,
    threshold: float = THRESHOLD_95,
    scale: float = 1.0,
    n_points: int = 31,
) -> Profile:
    """Profile likelihood of parameter `index`, followed outwards from the best fit to its bounds.

    objective : residuals in standard deviations, so that its cost is chi-square
    scale : the deviance is divided by it (1, or chi-square per degree of freedom where the data scatter more
        than their stated noise)
    threshold : deviance at the ends of the interval; the 95 % quantile of chi-square with one degree of
        freedom, or `threshold_95` where the noise may be larger than stated

    Source: Venzon and Moolgavkar 1988, Appl. Stat. 37:87; Raue et al. 2009, Bioinformatics 25:1923.
    """
    walker = _Walker(objective, tuple(parameters), best, index, scale, n_points)
    down, up = walker.walk(-1, threshold), walker.walk(+1, threshold)
    points = [*reversed(down.points), (best.theta[index], 0.0, best.theta), *up.points]
    values = np.array([value for value, _, _ in points])
    return Profile(
        parameters[index].name, values, np.array([each for _, each, _ in points]),
        np.array([theta for _, _, theta in points]),
        float(down.end[index]), float(up.end[index]), down.is_open, up.is_open,
        np.array([down.end, up.end]),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Side:
    points: list[_Point]
    end: Array
    is_open: bool


class _Walker:
    def __init__(
        self, objective: Objective, parameters: tuple[FitParameter, ...], best: Fit, index: int,
        scale: float, n_points: int,
    ):  # fmt: skip
        self.objective, self.parameters, self.best = objective, parameters, best
        self.index, self.scale, self.n_points = index, scale, n_points

    def walk(self, sign: int, threshold: float) -> _Side:
        """Step along the grid until the deviance exceeds the threshold, then locate the crossing."""
        parameter = self.parameters[self.index]
        start = float(self.best.theta[self.index])
        points: list[_Point] = []
        stop = parameter.high if sign > 0 else parameter.low
        pace = np.log(parameter.high / parameter.low) / self.n_points
        n = int(np.ceil(abs(np.log(stop / start)) / pace))
        if n == 0:
            return _Side([], self.best.theta, True)
        grid = start * np.exp(np.linspace(0.0, np.log(stop / start), n + 1)[1:])
        inside: _Point = (start, 0.0, self.best.theta)
        for value in grid:
            here = (float(value), *self.at(float(value), inside[2]))
            if here[1] > threshold:
                end, more = self._crossing(inside, here, threshold)
                points = sorted([*points, *more], key=lambda point: sign * point[0])
                return _Side(self._filled(points), end, False)
            points.append(here)
            inside = here
        return _Side(points, inside[2], True)

    def _filled(self, points: list[_Point]) -> list[_Point]:
        """Replace the points of a short side by enough points for a smooth curve."""
        if len(points) >= _FEWEST:
            return points
        start, last = float(self.best.theta[self.index]), points[-1]
        more: list[_Point] = []
        for share in np.arange(1, _FEWEST) / _FEWEST:
            value = float(start * (last[0] / start) ** share)
            more.append((value, *self.at(value, more[-1][2] if more else self.best.theta)))
        return [*more, last]

    def _crossing(self, inside: _Point, outside: _Point, threshold: float) -> tuple[Array, list[_Point]]:
        """Theta where the deviance reaches the threshold, by a bracketed secant search: the deviance's root
        is nearly linear in ln theta."""
        found = []
        for _ in range(12):
            low, high = (np.sqrt(max(point[1], 0.0)) for point in (inside, outside))
            share = min(max((np.sqrt(threshold) - low) / (high - low), 0.1), 0.9)
            value = float(inside[0] * (outside[0] / inside[0]) ** share)
            deviance, theta = self.at(value, inside[2])
            found.append((value, deviance, theta))
            if abs(deviance - threshold) < _CLOSE or abs(np.log(outside[0] / inside[0])) < 1e-3:
                break
            if deviance > threshold:
                outside = found[-1]
            else:
                inside = found[-1]
        return found[-1][2], found

    def at(self, value: float, guess: Array) -> tuple[float, Array]:
        """(deviance, theta) with this parameter held at `value` and the others refitted."""
        others = [k for k in range(len(self.parameters)) if k != self.index]
        if not others:
            theta = np.array([value])
            return self._deviance(self.objective(theta, False).cost), theta

        def held(part: Array, derivative: bool = True) -> Residual:
            theta = np.insert(part, self.index, value)
            full = self.objective(theta, derivative)
            return Residual(full.values, None if full.jacobian is None else full.jacobian[:, others])

        parameters = [self.parameters[k] for k in others]
        fit = best_of(held, parameters, [guess[others]])
        return self._deviance(fit.cost), np.insert(fit.theta, self.index, value)

    def _deviance(self, cost: float) -> float:
        return (cost - self.best.cost) / self.scale
