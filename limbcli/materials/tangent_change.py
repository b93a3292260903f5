"""How a law's tangent changes: by central differences of the law itself, point by point.

A derivative of the tangent is a third derivative of the energy, which no kernel gives. The law alone is
cheap and smooth: with a step of 6e-6 (the cube root of round-off) of F and of its numbers, about nine
digits are right, six with exponents of a hundred.
"""

from __future__ import annotations

import numpy as np

from limbcli.materials.stress import _evaluate
from limbcli.model import Array, IntArray

_STEP = 6e-6


def tangent_change(ops: IntArray, par: Array, F: Array, dF: Array, dpar: Array) -> Array:
    """Change (n, 6, 6) of CC = dS/dE, Voigt order, along dF (n, 3, 3) and dpar (n or 1, n_numbers).

    par, dpar (n or 1, n_numbers) : of a program; F (n, 3, 3). Each point has a step of its own, so
    that F moves by 6e-6 at the most and every number by 6e-6 of itself. Where a fibre stands on the
    beginning of its stretch the tangent jumps, and has no change.
    """
    sizes = np.where(par == 0.0, 1.0, abs(par))
    fastest = np.maximum(abs(dF).max(axis=(1, 2)), (abs(dpar) / sizes).max(axis=1, initial=0.0))
    step = np.where(fastest > 0.0, _STEP / np.where(fastest > 0.0, fastest, 1.0), 0.0)
    ends = []
    for h in (step, -step):
        moved = np.ascontiguousarray(F + h[:, None, None] * dF)
        numbers = np.ascontiguousarray(par + h[:, None] * dpar)
        S, CC = np.zeros((len(F), 6)), np.zeros((len(F), 6, 6))
        _evaluate(moved, ops, numbers, S, CC, True)
        ends.append(CC)
    width = np.where(step > 0.0, 2 * step, 1.0)
    return np.asarray((ends[0] - ends[1]) / width[:, None, None])
