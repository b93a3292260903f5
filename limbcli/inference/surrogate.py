"""A smooth surrogate of the simulation, built from the simulations that have already been run.

Profile likelihoods and fits from several starts need hundreds of predictions. Between the solved parameter
sets, the logarithms of the forces are interpolated by a Gaussian process that also uses the exact
derivatives; its predictive standard deviation shows where another simulation is needed.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from limbcli.inference.prediction import Prediction, SolvedPoints
from limbcli.model import Array, IntArray
from limbcli.numbers.compiled import njit

_LENGTHS = (0.5, 0.9, 1.6, 2.8, 5.0)  # candidate length scales in ln theta
_LARGEST_LOG = 50.0  # upper limit of logarithms, against overflow
_NUGGET = 1e-9  # added to the covariance's diagonal, relative to it
_SAME = 1e-3  # two points closer than this in ln theta coincide


@dataclass(frozen=True, eq=False)
class Node:
    """One solved point: x = ln theta (p,), y = ln value (q,), slope (q, p) dy/dx or None."""

    x: Array
    y: Array
    slope: Array | None


@dataclass(frozen=True, eq=False)
class Coordinates:
    """x = ln theta -> coordinates in which the surrogate is stationary, (1 + shift) ln(theta / largest +
    shift), shift 0 or 1: ln theta, or about linear in theta where it is not small. Forces grow as stretch^m,
    so that their logarithm is about linear in m. largest (p,) : ln of each parameter's largest solved value
    """

    largest: Array
    shift: Array

    def __call__(self, x: Array) -> tuple[Array, Array]:
        """Coordinates (..., p) and their derivatives by x (..., p)."""
        share = np.exp(np.minimum(x - self.largest, _LARGEST_LOG))
        scale = 1.0 + self.shift
        return scale * np.log(share + self.shift), scale * share / (share + self.shift)


class Surrogate:
    """ln theta (p,) -> ln value (q,), with derivative and standard deviation: universal kriging with
    derivatives, of a squared-exponential kernel over a linear trend. Length scales and each parameter's
    coordinate (`Coordinates`) maximise the likelihood over a small grid.

    Source: Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, sections 2.7, 9.4.
    """

    def __init__(self, nodes: Sequence[Node]):
        self.nodes = _thinned(nodes)
        self._graded = np.array([node.slope is not None for node in self.nodes])
        largest = np.max([node.x for node in self.nodes], axis=0)
        p = len(largest)
        grid = [np.array(each) for each in itertools.product(_LENGTHS, repeat=p)]
        best = self._best(Coordinates(largest, np.zeros(p)), grid)
        for k in range(p if len(self.nodes) > 1 else 0):
            shift = best.coordinates.shift + np.eye(p)[k]
            grid = [np.where(np.arange(p) == k, each, best.lengths) for each in _LENGTHS]
            best = max(best, self._best(Coordinates(largest, shift), grid), key=lambda each: each.score)
        self._model = best

    def __call__(self, x: Array) -> tuple[Array, Array]:
        """ln value (q,) and its derivative (q, p)."""
        model = self._model
        q = model.weights.shape[1]
        value, slope = np.empty(q), np.empty((q, len(x)))
        u, by_x = model.coordinates(np.asarray(x, dtype=float))
        _predict(u, model.nodes, model.lengths, self._graded, model.weights, model.trend, value, slope)
        return value, slope * by_x

    def deviation(self, x: Array) -> Array:
        """Standard deviation of ln value at x: (q,)."""
        model = self._model
        u, _ = model.coordinates(np.asarray(x, dtype=float))
        cross = self._covariance(u[None], model.nodes, model.lengths)[0]
        spread = 1.0 - cross @ cho_solve(model.factor, cross)
        leftover = np.concatenate([[1.0], u]) - model.solved_basis.T @ cross
        spread += leftover @ np.linalg.solve(model.information, leftover)
        return np.sqrt(max(float(spread), 0.0)) * model.amplitude

    def _best(self, coordinates: Coordinates, grid: Sequence[Array]) -> _Fitted:
        """The most likely fit in these coordinates over a grid of length scales (p,)."""
        nodes, by_x = coordinates(np.array([node.x for node in self.nodes]))
        rows = [node.y for node in self.nodes]
        for node, each in zip(self.nodes, by_x, strict=True):
            rows.extend((node.slope / each).T if node.slope is not None else ())
        fits = [self._fit(coordinates, nodes, np.array(rows), lengths) for lengths in grid]
        # the likelihood of the slopes by x, not by the coordinates
        scale = np.log(by_x[self._graded]).sum()
        found = [replace(each, score=each.score - scale) for each in fits if each is not None]
        assert found, "the nugget keeps every covariance positive definite"
        return max(found, key=lambda each: each.score)

    def _fit(self, coordinates: Coordinates, nodes: Array, targets: Array, lengths: Array) -> _Fitted | None:
        covariance = self._covariance(nodes, nodes, lengths, graded_a=self._graded)
        covariance += _NUGGET * np.diag(np.diag(covariance))
        try:
            factor = cho_factor(covariance, lower=True)
        except np.linalg.LinAlgError:
            return None
        n, p = nodes.shape
        tangents = np.tile(np.hstack([np.zeros((p, 1)), np.eye(p)]), (int(self._graded.sum()), 1))
        basis = np.vstack([np.hstack([np.ones((n, 1)), nodes]), tangents])
        solved_basis = cho_solve(factor, basis)
        information = basis.T @ solved_basis
        information += 1e-9 * np.trace(information) * np.eye(len(information))
        trend = np.linalg.solve(information, solved_basis.T @ targets)
        residual = targets - basis @ trend
        weights = cho_solve(factor, residual)
        n_rows = len(residual)
        variance = np.maximum(np.sum(residual * weights, axis=0) / max(n_rows - basis.shape[1], 1), 1e-16)
        log_determinant = 2 * np.log(np.diag(factor[0])).sum()
        score = -0.5 * (n_rows * np.log(variance).mean() + log_determinant)
        return _Fitted(
            coordinates, nodes, lengths, factor, weights, trend, solved_basis, information,
            np.sqrt(variance), score,
        )  # fmt: skip

    def _covariance(self, a: Array, b: Array, lengths: Array, *, graded_a: Array | None = None) -> Array:
        """Covariance of (values of a, gradients of graded a) with those of the nodes b."""
        difference = (a[:, None, :] - b[None, :, :]) / lengths
        kernel = np.exp(-0.5 * np.sum(difference**2, axis=2))
        scaled = difference / lengths
        with_slope = kernel[:, :, None] * scaled  # cov(f(a), d f(b) / d b_j)
        n_slopes = int(self._graded.sum()) * a.shape[1]
        to_slopes = with_slope[:, self._graded].reshape(len(a), n_slopes)
        top = np.hstack([kernel, to_slopes])
        if graded_a is None:
            return top
        p = a.shape[1]
        from_slopes = -np.swapaxes(with_slope, 1, 2)[graded_a].reshape(int(graded_a.sum()) * p, len(b))
        hessian = kernel[:, :, None, None] * (
            np.diag(1.0 / lengths**2) - scaled[..., :, None] * scaled[..., None, :]
        )
        block = hessian[graded_a][:, self._graded].transpose(0, 2, 1, 3)
        bottom = np.hstack([from_slopes, block.reshape(int(graded_a.sum()) * p, n_slopes)])
        return np.vstack([top, bottom])


@dataclass(frozen=True, eq=False)
class _Fitted:
    coordinates: Coordinates
    nodes: Array
    lengths: Array
    factor: tuple[Array, bool]
    weights: Array
    trend: Array
    solved_basis: Array
    information: Array
    amplitude: Array
    score: float


def _thinned(nodes: Sequence[Node]) -> tuple[Node, ...]:
    """The nodes without (nearly) coincident points; of two, the later one is kept."""
    kept: list[Node] = []
    for node in reversed(nodes):
        if all(np.max(np.abs(node.x - other.x)) > _SAME for other in kept):
            kept.append(node)
    return tuple(reversed(kept))


@njit
def _predict(x, nodes, lengths, graded, weights, trend, value, slope):  # type: ignore[no-untyped-def]
    """ln values (q,) and their slopes (q, p) at x: the trend, and weights times the covariances with the
    values of all nodes and then the gradients of the graded ones."""
    n, p = nodes.shape
    q = len(value)
    for c in range(q):
        value[c] = trend[0, c]
        for j in range(p):
            value[c] += trend[1 + j, c] * x[j]
            slope[c, j] = trend[1 + j, c]
    scaled, row = np.empty(p), n
    for i in range(n):
        square = 0.0
        for j in range(p):
            away = (x[j] - nodes[i, j]) / lengths[j]
            square += away * away
            scaled[j] = away / lengths[j]
        kernel = np.exp(-0.5 * square)
        for c in range(q):
            part = kernel * weights[i, c]
            value[c] += part
            for j in range(p):
                slope[c, j] -= scaled[j] * part
        if not graded[i]:
            continue
        for k in range(p):
            for c in range(q):
                part = kernel * weights[row, c]
                value[c] += scaled[k] * part
                slope[c, k] += part / lengths[k] ** 2
                for j in range(p):
                    slope[c, j] -= scaled[j] * scaled[k] * part
            row += 1


_LEAST = 1e-12  # lower limit of a value before its logarithm is taken


class Emulator:
    """The surrogate with the interface of its curve, and the standard deviation of each value; `refresh`
    after each solve. Outputs without derivatives (wave speeds) are interpolated without them."""

    def __init__(self, curve: SolvedPoints):
        self.curve = curve
        self.refresh()

    def refresh(self) -> None:
        solved = self.curve.solved
        n = len(solved[0][1].values)
        graded = np.array([_graded(answer) for _, answer in solved]).mean(axis=0) > 0.0
        self._groups = []
        for rows, use in ((np.flatnonzero(graded), True), (np.flatnonzero(~graded), False)):
            if len(rows):
                nodes = [_node(theta, answer, rows, use) for theta, answer in solved]
                self._groups.append((rows, Surrogate(nodes)))
        self._n = n

    def __call__(self, theta: Array, wrt: Sequence[int] = ()) -> Prediction:
        values, jacobian = np.empty(self._n), np.empty((self._n, len(theta)))
        x = np.log(theta)
        for rows, surrogate in self._groups:
            y, slope = surrogate(x)
            values[rows] = np.exp(np.minimum(y, _LARGEST_LOG))
            jacobian[rows] = values[rows, None] * slope / theta
        return Prediction(values, jacobian)

    def deviation(self, theta: Array) -> Array:
        """Standard deviation of the values' logarithms: (n,)."""
        deviation = np.empty(self._n)
        for rows, surrogate in self._groups:
            deviation[rows] = surrogate.deviation(np.log(theta))
        return deviation

    def distance(self, theta: Array) -> float:
        """Distance to the nearest solved point: the largest change of a parameter's logarithm."""
        return min(float(np.max(np.abs(np.log(theta / other)))) for other, _ in self.curve.solved)


def _graded(answer: Prediction) -> Array:
    """Outputs that have all their derivatives: (n,) bool."""
    if answer.jacobian is None:
        return np.zeros(len(answer.values), dtype=bool)
    return np.asarray(np.isfinite(answer.jacobian).all(axis=1))


def _node(theta: Array, answer: Prediction, rows: IntArray, graded: bool) -> Node:
    values = np.maximum(answer.values[rows], _LEAST)
    slope = None
    if graded and answer.jacobian is not None and np.isfinite(answer.jacobian[rows]).all():
        slope = answer.jacobian[rows] * theta / values[:, None]
    return Node(np.log(theta), np.log(values), slope)
