"""Directional derivative of a law's tangent, by central differences of the law at each point.

The derivative of the tangent is a third derivative of the energy, which the kernels do not provide. The law
itself is cheap and smooth: with a step of 6e-6 (the cube root of round-off) in F and in its numbers, about
nine digits are correct, six with exponents of a hundred.
"""

from __future__ import annotations

import numpy as np

from limbcli.materials.stress import _evaluate
from limbcli.model import Array, IntArray

_STEP = 6e-6


def tangent_change(ops: IntArray, par: Array, F: Array, dF: Array, dpar: Array) -> Array:
    """Derivative (n, 6, 6) of CC = dS/dE, Voigt order, along dF (n, 3, 3) and dpar (n or 1, n_numbers).

    par, dpar (n or 1, n_numbers) : of a program; F (n, 3, 3). The step is chosen for each point such that F
    changes by at most 6e-6 and every number by at most 6e-6 of itself. Where a fibre is exactly at the onset
    of its stretch the tangent is discontinuous and the result is meaningless.
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
