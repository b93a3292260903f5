"""One likelihood made of blocks: depth at given force, wave speeds and layers of a site or state, or force at
given depth.

Each block is simulated at a place (the parameters of its curve) that follows from theta, evaluated on a
surrogate of the curve's solved points, and compared with its data in standard deviations. At fixed shape of
the law every stress is proportional to c, so that forces scale with c and speeds with its square root, and
only changes of the shape need simulations. This does not hold where layers with a fixed stiffness of their
own are in the model; there c is a parameter of the curve as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from limbcli.inference.monotone_interpolation import pchip_sample
from limbcli.inference.parameter import FitParameter
from limbcli.inference.prediction import Objective, Prediction, Residual
from limbcli.inference.site_depth import RestSpeed, SiteMeasurement, SitePrediction, predict_site
from limbcli.inference.surrogate import Emulator
from limbcli.model import Array
from limbcli.numbers.whitening import Whitener

C_STEP_FACTOR = 2.0  # largest factor of c from the solved points to a new one, where c is simulated
_LEAST = 1e-9  # lower limit of predicted forces (N) and relative speeds, before logarithms are taken
_SAME_WEIGHT = 0.02  # change of ln weight below which the weights count as unchanged
_SURE = 0.05  # largest accepted surrogate error in one of several blocks of a curve, in standard deviations
EvenSpeed = Callable[[Array], tuple[float, Array]]
"""Curve parameters -> ln of the speed in evenly stretched tissue at c0, and its derivatives by their ln."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where a block is simulated: ln (factor on c, gain, parameters of the curve) is affine in ln theta.

    offset (2 + n_place,), factors (2 + n_place, n_theta)
    """

    offset: Array
    factors: Array

    @staticmethod
    def of(
        n_theta: int, *, c0: float, shape: Sequence[int], beside_layers: bool = False,
        gain: int | None = None, offset: Array | None = None, factors: Array | None = None,
    ) -> Place:  # fmt: skip
        """The factor c / c0 on all stresses, or first among the curve's parameters beside layers of fixed
        stiffness; then the `shape`, columns of theta; then ln parameters offset (n,) + factors (n, n_theta).

        gain : column of the gain in theta; None without one
        """
        rows = np.zeros((2 + int(beside_layers) + len(shape), n_theta))
        c_row = 2 * int(beside_layers)
        rows[c_row, 0] = 1.0
        rows[len(rows) - len(shape) + np.arange(len(shape)), list(shape)] = 1.0
        if gain is not None:
            rows[1, gain] = 1.0
        own = np.zeros(len(rows))
        own[c_row] = -np.log(c0)
        if offset is None or factors is None:
            return Place(own, rows)
        return Place(np.concatenate([own, offset]), np.vstack([rows, factors]))

    def __call__(self, theta: Array) -> tuple[float, float, Array]:
        """Factor on c, gain, and the curve's parameters (n_place,)."""
        found = np.exp(self.offset + self.factors @ np.log(theta))
        return float(found[0]), float(found[1]), found[2:]


class DataBlock:
    """Data of one simulated curve; slopes are by ln theta. Its weights are fixed unless stated."""

    emulator: Emulator
    place: Place

    def residual(self, theta: Array) -> tuple[Array, Array]:
        """Values (n,) in standard deviations and slopes (n, n_theta)."""
        raise NotImplementedError

    def uncertainty(self, theta: Array) -> float:
        """Error of the surrogate at theta, in standard deviations of the data."""
        raise NotImplementedError

    def changes(self, theta: Array) -> bool:
        """Whether the weights of the residuals at this theta differ from those in use."""
        return False

    def weigh(self, theta: Array) -> None:
        """Use the weights at this theta."""

    def distance(self, theta: Array) -> float:
        """From the nearest solved point of the curve, in ln of its parameters."""
        return self.emulator.distance(self.place(theta)[2])


class SiteBlock(DataBlock):
    """Depth at given force, wave speeds and layers of one site or state.

    log_speed_0 : of `predict_site`; it and the speeds of the curve are relative to `even_speed` where that is
        given, and the speed at rest is then the last value of the curve's speeds
    """

    def __init__(
        self, data: SiteMeasurement, emulator: Emulator, place: Place, log_speed_0: RestSpeed = 0.0, *,
        even_speed: EvenSpeed | None = None,
    ):  # fmt: skip
        self.data, self.emulator, self.place = data, emulator, place
        self.log_speed_0, self.even_speed = log_speed_0, even_speed

    def weigh(self, theta: Array) -> None:
        self.weights = self._weights_at(theta)

    def changes(self, theta: Array) -> bool:
        ratio = np.log(self._weights_at(theta) / self.weights)
        return bool(np.abs(ratio).max(initial=0.0) > _SAME_WEIGHT)

    def _weights_at(self, theta: Array) -> Array:
        return self.data.weights_at(self.predict(theta).stiffness)

    def predict(self, theta: Array) -> SitePrediction:
        """Prediction by the surrogate; slopes by ln c, ln gain and ln of the curve's parameters."""
        c_ratio, gain, place = self.place(theta)
        answer, rest = self.emulator(place), self.log_speed_0
        if self.even_speed is not None:
            # forces and speeds, and the speed at rest, of a curve whose speeds are relative to this one
            even, even_slope = self.even_speed(place)
            n, known = len(self.data.knots), np.maximum(answer.values, _LEAST)  # surrogates may give anything
            by_log = answer.slopes * place / known[:, None]
            speeds = known[n : 2 * n] * np.exp(even)
            slopes = (by_log[n : 2 * n] + even_slope) * speeds[:, None] / place
            at_rest = even + float(np.log(known[2 * n])), even_slope + by_log[2 * n]
            values, jacobian = np.concatenate([known[:n], speeds]), np.vstack([answer.slopes[:n], slopes])
            answer, rest = Prediction(values, jacobian), lambda _shape: at_rest
        return predict_site(answer, self.data, place, c_ratio=c_ratio, gain=gain, log_speed_0=rest)

    def residual(self, theta: Array) -> tuple[Array, Array]:
        data, found, weights = self.data, self.predict(theta), self.weights
        values = [
            (data.depth - found.depth) / weights,
            (data.log_speed - found.log_speed) / data.speed_deviation,
            data.layers.whitened(data.layers.thickness - found.layers),
        ]
        slopes = [
            found.depth_slope / weights[:, None],
            found.log_speed_slope / data.speed_deviation[:, None],
            data.layers.whitened(found.layers_slope),
        ]
        return np.concatenate(values), -np.vstack(slopes) @ self.place.factors

    def uncertainty(self, theta: Array) -> float:
        data, found = self.data, self.predict(theta)
        deviation, n = self.emulator.deviation(self.place(theta)[2]), len(data.knots)
        force = np.interp(found.depth, data.knots, deviation[:n]) * data.force / found.stiffness
        terms = [force / self.weights]
        if len(data.log_speed):
            rest = 0.0 if self.even_speed is None else deviation[2 * n]
            at = np.interp(data.speed_force, np.r_[0.0, data.force], np.r_[0.0, found.depth])
            speed = np.interp(at, np.r_[0.0, data.knots], np.r_[rest, deviation[n : 2 * n]])
            terms.append(speed / data.speed_deviation)
        if len(data.layers):
            borders = deviation[-n * len(data.layers.rest) :].max() * data.layers.rest
            terms.append(data.layers.whitened(borders[data.layers.layer]))
        return float(np.linalg.norm(np.concatenate(terms)))


@dataclass(frozen=True, eq=False)
class ForceBlock(DataBlock):
    """Force (n,) N at given depth (n,) mm, simulated at `knots` (n_knots,) mm.

    covariance : (n, n) N^2; it stays as it is
    share : (n,) d ln force / d ln c
    """

    emulator: Emulator
    place: Place
    knots: Array
    depth: Array
    force: Array
    covariance: Array
    share: Array

    @cached_property
    def _whiten(self) -> Whitener:
        return Whitener.of(self.covariance)

    def residual(self, theta: Array) -> tuple[Array, Array]:
        c_ratio, gain, place = self.place(theta)
        answer = self.emulator(place)
        sample = pchip_sample(np.r_[0.0, self.knots], np.r_[0.0, answer.values], self.depth)
        factor = gain * c_ratio**self.share
        force = factor * sample.values
        by_place = factor[:, None] * (sample.weights[:, 1:] @ (answer.slopes * place))
        slopes = np.column_stack([force * self.share, force, by_place]) @ self.place.factors
        return self._whiten(self.force - force), -self._whiten(slopes)

    def uncertainty(self, theta: Array) -> float:
        c_ratio, _, place = self.place(theta)
        error = np.interp(
            self.depth, self.knots, self.emulator.deviation(place) * self.emulator(place).values
        )
        return float(np.linalg.norm(c_ratio**self.share * error / np.sqrt(np.diag(self.covariance))))


class Likelihood:
    """Estimation problem of `adaptive_profiles`; theta begins with c.

    parameters : the whole vector theta, on the log scale
    profiled : indices of the parameters to profile
    simulated : indices of the parameters that are inputs of a simulation
    n_freedom : number of data minus number of parameters
    """

    def __init__(
        self, parameters: Sequence[FitParameter], blocks: Sequence[DataBlock], starts: Sequence[Array], *,
        profiled: Sequence[int], priors: Sequence[tuple[int, float, float]], n_shape: int,
    ):  # fmt: skip
        """
        priors : (index, mean, standard deviation of the logarithm)
        n_shape : number of the law's parameters, which follow c; simulations step outwards in these and c
        """
        self.parameters, self.blocks, self.profiled = list(parameters), blocks, tuple(profiled)
        self.n_shape, self._starts, self._priors = n_shape, list(starts), list(priors)
        several = np.vstack([each.place.factors[2:] for each in blocks])
        self.simulated = tuple(np.flatnonzero(several.any(axis=0)).tolist())
        free = set(self.profiled) - {index for index, _, _ in priors}
        for each in blocks:
            each.weigh(self._starts[0])
        n_data = sum(len(each.residual(self._starts[0])[0]) for each in blocks)
        self.n_freedom = max(n_data - len(free), 1)

    def objective(self) -> Objective:
        """Residuals in standard deviations, on the current surrogates."""
        index = [each for each, _, _ in self._priors]
        mean, deviation = np.array([each[1:] for each in self._priors]).reshape(-1, 2).T
        prior_slopes = np.eye(len(self.parameters))[index] / deviation[:, None]

        def residual(theta: Array, derivative: bool = True) -> Residual:
            values, slopes = zip(*(each.residual(theta) for each in self.blocks), strict=True)
            prior = np.log(theta[index] / mean) / deviation
            return Residual(np.concatenate([*values, prior]), np.vstack([*slopes, prior_slopes]) / theta)

        return residual

    def settle(self, theta: Array) -> bool:
        """Recompute the weights of the residuals at this fit if any changes by 2 %; returns whether."""
        if not any(each.changes(theta) for each in self.blocks):
            return False
        for each in self.blocks:
            each.weigh(theta)
        return True

    def starts(self) -> list[Array]:
        return list(self._starts)

    def place(self, k: int, theta: Array) -> Array:
        """Parameters of the curve of block k: the law's shape, preceded by c / c0 where layers have a fixed
        stiffness, and followed by the stretches of a state."""
        return self.blocks[k].place(theta)[2]

    def uncertainty(self, theta: Array) -> float:
        """Error of the surrogates at theta, in standard deviations of the data."""
        return float(np.linalg.norm([each.uncertainty(theta) for each in self.blocks]))

    def distance(self, theta: Array) -> float:
        """Distance to the nearest simulated point, in ln of the parameters that need a simulation."""
        return max(each.distance(theta) for each in self.blocks)

    def solve(self, theta: Array) -> None:
        """Simulate every curve at theta and refresh the surrogates; of several blocks of a curve those that
        are too uncertain, or else the farthest from any solved point. Raises SolveError if that fails."""
        for emulator in dict.fromkeys(each.emulator for each in self.blocks):
            own = [each for each in self.blocks if each.emulator is emulator]
            chosen = [each for each in own if len(own) > 1 and each.uncertainty(theta) > _SURE]
            chosen = chosen or [max(own, key=lambda each: each.distance(theta))]
            for x in [each.place(theta)[2] for each in chosen]:
                emulator.curve(x, tuple(range(len(x))))
            emulator.refresh()

    def within_reach(self, theta: Array) -> Array:
        """theta with c and the shape limited to one step factor beyond the solved points of every curve."""
        near = np.array(theta)
        for each in self.blocks:
            solved = np.log([place for place, _ in each.emulator.curve.solved])
            for row, logs in zip(each.place.factors[2:], (solved - each.place.offset[2:]).T, strict=True):
                k = int(np.argmax(np.abs(row)))  # a stretch may enter with -1
                if k > self.n_shape or np.count_nonzero(row) != 1:
                    continue
                factor = C_STEP_FACTOR if k == 0 else self.parameters[k].step_factor
                near[k] = np.clip(near[k], np.exp(logs.min()) / factor, np.exp(logs.max()) * factor)
        return near

    def solved_at(self, theta: Array) -> Array:
        """The law's shape parameters, and those of the states."""
        return np.asarray(theta[1 : 1 + max(self.profiled)])
