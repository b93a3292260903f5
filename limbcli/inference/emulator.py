"""Surrogate of a curve, rebuilt from all solved points in its `SolvedPoints`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from limbcli.inference.prediction import Prediction, SolvedPoints
from limbcli.inference.surrogate import Node, Surrogate
from limbcli.model import Array, IntArray

_LARGEST_LOG = 50.0  # upper limit of ln value, against overflow
_LEAST = 1e-12  # lower limit of a value before its logarithm is taken


class Emulator:
    """theta -> values, with the interface of the curve itself, and the standard deviation of each value.

    Outputs whose derivatives the curve provides are interpolated with these derivatives, the others (wave
    speeds) without. Call `refresh` after each solve.
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
