"""Principal stretches of the tissue from its deformation gradient."""

from __future__ import annotations

import numpy as np

from limbcli.model import Array


def principal_stretches(deformation_gradient: Array) -> Array:
    """Principal stretches: the singular values of F, largest first.

    1 is the undeformed length; 0.8 is a shortening by 20 % in that direction.

    Parameters
    ----------
    deformation_gradient : array, shape (..., 3, 3)

    Returns
    -------
    array, shape (..., 3), dimensionless

    >>> principal_stretches(np.diag([0.5, 2.0, 1.0]))
    array([2. , 1. , 0.5])
    """
    stretches = np.linalg.svd(deformation_gradient, compute_uv=False)
    return np.asarray(stretches, dtype=np.float64)
