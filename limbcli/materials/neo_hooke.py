"""Compressible neo-Hookean solid: W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2.

Parameters: Lame's mu and lambda (MPa); FEBio's "neo-Hookean" uses E and v.
Source: Bonet & Wood, Nonlinear Continuum Mechanics, eq. 6.27; FEBio User Manual 4.0.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.materials.kernel import Deformation, Kernel
from limbcli.materials.law import FebioNames, Law
from limbcli.materials.tensors import add_outer, add_square, inverse6
from limbcli.numbers.compiled import njit


@njit
def add_neo_hooke(par, off, extra, J, work, S, CC, tangent):
    """par[off:] = mu, lambda."""
    C, inverse = work[0][0], work[0][1]
    mu, lam = par[off], par[off + 1]
    inverse6(C, inverse)
    lnJ = np.log(J)
    for p in range(6):
        S[p] += (lam * lnJ - mu) * inverse[p]
        if p < 3:
            S[p] += mu
    if tangent:
        add_outer(CC, lam, inverse, inverse)
        add_square(CC, 2.0 * (mu - lam * lnJ), inverse)


def energy(p: Any, extra: int, at: Deformation) -> Any:
    """W (n_cells, n_gauss) MPa; p (n_cells, 2, 1)."""
    lnJ = np.log(at.J)
    return 0.5 * p[:, 0] * (at.squares.sum(-1) - 3 - 2 * lnJ) + 0.5 * p[:, 1] * lnJ**2


KERNEL = Kernel(add_neo_hooke, energy)
LAW = Law(
    "neo_hooke",
    KERNEL,
    {"mu": None, "lambda": None},
    lambda v: [v["mu"], v["lambda"]],
    positive=("mu",),
    febio=FebioNames("neo-Hookean", elastic_constants=True),
)
