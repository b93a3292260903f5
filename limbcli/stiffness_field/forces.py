"""What the force under a site's probe says of its c, m and f_kappa together.

A force often tells neither m nor f_kappa alone, but well which c, m and f_kappa give it. About one tissue it
is linear in their logarithms, and then equal to a normal reading of all three: values, and a covariance that
is wide along what the force does not tell.

Errors of the site's model (mesh, boundaries, geometry) are no noise: with them the field's tissue would give
another force than the one read. They count in the field's intervals and draws alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from limbcli.model import Array

_SILENT = 1e-4  # precision of ln of a parameter along what the force does not tell

ForceOf = Callable[[Array], tuple[Array, Array]]
"""ln of c (MPa), m, f_kappa (3,) -> ln of the forces (n,) N and their derivatives (n, 3)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ForceReading:
    """Forces of a site, as its own model has them, at n depths.

    depths : (n,) mm; fitted, noise : (n,) N, and their standard deviations, independent of each other
    limb_over_site : (n,) force of the limb over that of the site's model, of the same tissue
    model_errors : (k, n) of ln force, one standard deviation of each error that does not move the field
    predict : the forces of a tissue in the site's model
    contact_penalty : of the probe in these forces, as a multiple of the tissue's stiffness at rest
    """

    depths: Array
    fitted: Array
    noise: Array
    limb_over_site: Array
    model_errors: Array
    predict: ForceOf
    contact_penalty: float

    def off(self, logs: Array) -> Array:
        """ln of the forces read (n,) over the limb's of a tissue, ln of c, m, f_kappa (3,)."""
        return np.asarray(np.log(self.fitted / self.limb_over_site) - self.predict(logs)[0])

    def ratio(self, logs: Array) -> float:
        """The limb's force of a tissue over that read, at the deepest level."""
        k = int(np.argmax(self.depths))
        return float(self.limb_over_site[k] * np.exp(self.predict(logs)[0][k]) / self.fitted[k])


@dataclass(frozen=True, eq=False)
class LinearReading:
    """A normal reading of ln c, ln m, ln f_kappa: values (3,), covariance (3, 3) of noise, and of the model's
    errors."""

    values: Array
    noise: Array
    model_error: Array


def linear_reading(reading: ForceReading, logs: Array, own_error: float = 0.0) -> LinearReading:
    """The reading about a tissue, ln of c, m, f_kappa (3,).

    own_error : standard deviation of an error of ln force that is the site's own, common to its depths
    """
    off, slopes = reading.off(logs), reading.predict(logs)[1]
    root = np.linalg.cholesky(np.diag((reading.noise / reading.fitted) ** 2) + own_error**2)
    columns = solve_triangular(root, slopes, lower=True)
    precision, axes = np.linalg.eigh(columns.T @ columns)
    noise = (axes / (np.maximum(precision, 0.0) + _SILENT)) @ axes.T
    to_values = noise @ solve_triangular(root, columns, lower=True, trans="T").T
    moved = to_values @ reading.model_errors.T
    return LinearReading(logs + to_values @ off, noise, moved @ moved.T)
