"""A curve's surrogate, made anew from everything its `SolvedPoints` holds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.inference.prediction import Prediction, SolvedPoints
from limbcli.inference.surrogate import Node, Surrogate
from limbcli.model import Array, IntArray

_LARGEST_LOG = 50.0
_LEAST = 1e-12


class Emulator:
    """theta -> values like the curve itself, and how sure each value is.

    Outputs whose derivatives the curve gives are interpolated with them, the others
    (wave speeds) without. Call `refresh` after every solve.
    """

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
        """To the nearest solved point: the largest change of a parameter's logarithm."""
        return min(float(np.max(np.abs(np.log(theta / other)))) for other, _ in self.curve.solved)


def _graded(answer: Prediction) -> Array:
    """Which outputs have all their derivatives: (n,) bool."""
    if answer.jacobian is None:
        return np.zeros(len(answer.values), dtype=bool)
    return np.asarray(np.isfinite(answer.jacobian).all(axis=1))


def _node(theta: Array, answer: Prediction, rows: IntArray, graded: bool) -> Node:
    values = np.maximum(answer.values[rows], _LEAST)
    slope = None
    if graded and answer.jacobian is not None and np.isfinite(answer.jacobian[rows]).all():
        slope = answer.jacobian[rows] * theta / values[:, None]
    return Node(np.log(theta), np.log(values), slope)
