"""Whitened residual and sensitivities of a fitted model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from limbcli.model import Array

_RANK = 1e-8


def _span(jacobian: Array) -> Array:
    """Orthonormal basis (n, rank) of the column space."""
    if jacobian.shape[1] == 0:
        return np.zeros((len(jacobian), 0))
    u, s, _ = np.linalg.svd(_even(jacobian), full_matrices=False)
    return np.asarray(u[:, s > _RANK * max(float(s[0]), 1e-300)])


def _even(columns: Array) -> Array:
    """Columns scaled to unit length."""
    length = np.linalg.norm(columns, axis=0)
    return columns / np.where(length > 0, length, 1.0)


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Whitened residual r (n,), sensitivities J (n, p) of the fitted parameters, and the projector P off J.

    basis : (n, rank) orthonormal, spans the columns of J; P = I - basis basis'
    """

    residual: Array
    jacobian: Array
    basis: Array

    @staticmethod
    def of(residual: Array, jacobian: Array, *, as_it_stands: bool = False) -> LinearFit:
        """
        as_it_stands : judge the fit at the point where it stopped. If a further linear step along J would
            reduce chi2 by more than one, that direction is removed from the span. The fit was stopped by a
            prior, a bound, or a kink in the model, where the derivatives are those of neither side; following
            the derivatives would assume implausible sizes.
        """
        basis = _span(jacobian)
        pull = basis.T @ residual
        if as_it_stands and float(pull @ pull) > 1.0:
            basis = basis @ null_space(pull[None, :])
        return LinearFit(residual, jacobian, basis)

    @property
    def nu(self) -> int:
        """Degrees of freedom: rank of P."""
        return len(self.residual) - self.basis.shape[1]

    def project(self, x: Array) -> Array:
        """P x: the part of x that no change of the fitted parameters can reproduce; x (n,) or (n, k).

        >>> state = LinearFit.of(np.zeros(2), np.array([[1.0], [0.0]]))
        >>> state.project(np.array([3.0, 4.0]))
        array([0., 4.])
        """
        return x - self.basis @ (self.basis.T @ x)

    @property
    def left(self) -> Array:
        """P r (n,)."""
        return self.project(self.residual)

    @property
    def chi2(self) -> float:
        left = self.left
        return float(left @ left)
