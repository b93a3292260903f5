"""Compressible neo-Hookean solid: W = mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2.

Inside: Lame's mu and lambda (MPa); FEBio's "neo-Hookean" writes E and v.
Source: Bonet & Wood, Nonlinear Continuum Mechanics, eq. 6.27; FEBio User Manual 4.0.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from limbcli.materials.tensors import add_outer, add_square, inverse6


@njit(cache=True)
def add_neo_hooke(par, off, J, C, inverse, S, CC, tangent):
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
