"""A smooth surrogate of the simulation, built from the simulations that have already been run.

Profile likelihoods and fits from several starts need hundreds of predictions. Between the solved parameter
sets, the logarithms of the forces are interpolated by a Gaussian process that also uses the exact
derivatives; its predictive standard deviation shows where another simulation is needed.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from limbcli.model import Array
from limbcli.numbers.compiled import njit

_LENGTHS = (0.5, 0.9, 1.6, 2.8, 5.0)  # candidate length scales in ln theta
_NUGGET = 1e-9  # added to the covariance's diagonal, relative to it
_SAME = 1e-3  # two points closer than this in ln theta coincide


@dataclass(frozen=True, eq=False)
class Node:
    """One solved point: x = ln theta (p,), y = ln value (q,), slope (q, p) dy/dx or None."""

    x: Array
    y: Array
    slope: Array | None


class Surrogate:
    """ln theta (p,) -> ln value (q,), with derivative and standard deviation.

    Squared-exponential kernel in ln theta over a linear trend (universal kriging with derivatives); the
    length scales maximise the likelihood over a small grid.

    Source: Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, sections 2.7, 9.4.
    """

    def __init__(self, nodes: Sequence[Node]):
        self.nodes = _thinned(nodes)
        self._x = np.array([node.x for node in self.nodes])
        self._graded = np.array([node.slope is not None for node in self.nodes])
        self._targets = self._stack()
        p = self._x.shape[1]
        best: _Fitted | None = None
        for lengths in itertools.product(_LENGTHS, repeat=p):
            fitted = self._fit(np.array(lengths))
            if fitted is not None and (best is None or fitted.score > best.score):
                best = fitted
        assert best is not None, "the nugget keeps every covariance positive definite"
        self._model = best

    def __call__(self, x: Array) -> tuple[Array, Array]:
        """ln value (q,) and its derivative (q, p)."""
        model, q = self._model, self._targets.shape[1]
        value, slope = np.empty(q), np.empty((q, len(x)))
        x = np.ascontiguousarray(x, dtype=float)
        _predict(x, self._x, model.lengths, self._graded, model.weights, model.trend, value, slope)
        return value, slope

    def deviation(self, x: Array) -> Array:
        """Standard deviation of ln value at x: (q,)."""
        model = self._model
        cross = self._covariance(x[None], self._x, model.lengths)[0]
        spread = 1.0 - cross @ cho_solve(model.factor, cross)
        leftover = np.concatenate([[1.0], x]) - model.solved_basis.T @ cross
        spread += leftover @ np.linalg.solve(model.information, leftover)
        return np.sqrt(max(float(spread), 0.0)) * model.amplitude

    def _stack(self) -> Array:
        rows = [node.y for node in self.nodes]
        for node in self.nodes:
            rows.extend(node.slope.T if node.slope is not None else ())
        return np.array(rows)

    def _basis(self) -> Array:
        n, p = self._x.shape
        tangent = np.hstack([np.zeros((p, 1)), np.eye(p)])
        return np.vstack(
            [np.hstack([np.ones((n, 1)), self._x]), *[tangent for _ in range(self._graded.sum())]]
        )

    def _fit(self, lengths: Array) -> _Fitted | None:
        covariance = self._covariance(self._x, self._x, lengths, graded_a=self._graded)
        covariance += _NUGGET * np.diag(np.diag(covariance))
        try:
            factor = cho_factor(covariance, lower=True)
        except np.linalg.LinAlgError:
            return None
        basis = self._basis()
        solved_basis = cho_solve(factor, basis)
        information = basis.T @ solved_basis
        information += 1e-9 * np.trace(information) * np.eye(len(information))
        trend = np.linalg.solve(information, solved_basis.T @ self._targets)
        residual = self._targets - basis @ trend
        weights = cho_solve(factor, residual)
        n = len(residual)
        variance = np.maximum(np.sum(residual * weights, axis=0) / max(n - basis.shape[1], 1), 1e-16)
        log_determinant = 2 * np.log(np.diag(factor[0])).sum()
        score = -0.5 * (n * np.log(variance).mean() + log_determinant)
        return _Fitted(lengths, factor, weights, trend, solved_basis, information, np.sqrt(variance), score)

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
