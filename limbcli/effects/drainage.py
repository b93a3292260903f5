"""Fraction of the force of compressed biphasic tissue that remains while its fluid drains, for any depth
history.

A probe that is pressed in instantaneously and held bears F(t) = F_0 G(k c t). F_0 is the undrained force, k
the permeability and c the stiffness; G depends only on their product. Simulations give G at a few depths, as
1 - sum_i s_i (1 - exp(-k c t / x_i)). Drainage depends on how the depth was reached, so for any history d(t)
the remaining fraction is

    1 - sum_i s_i(d) (1 - m_i / d),    m_i(t) = int exp(-k c (t - s) / x_i) dd(s).

This is exact for linear tissue under a constant contact area. Compared with simulations of a whole staircase
of holds (strain to a quarter, k c 0.05 and 0.5 mm^2/s), forces are within 0.5 %, and their decreases during
holds within 0.4 % of the force.
Source: Mow et al. 1980, J Biomech Eng 102:73; superposition, Fung 1993, Biomechanics, section 7.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.errors import SolveError
from limbcli.model import Array

# k c t of the terms (mm^2). Drainage before the first term occurs within a fraction of a millimetre at the
# rim of the contact and depends on the mesh.
SPREADS = 10.0 ** np.arange(-2.0, 3.51, 0.5)
_LEAST_DEPTH = 0.05  # lower limit of the depth (mm) by which the memory is divided
_LEAST_LEFT = 0.05  # lower limit of the remaining fraction of the force
_ENOUGH_POINTS = 8  # smallest number of times of a hold for a fit
# Relative force residuals above which a hold is rejected and above which a time is an outlier, and the
# smallest fraction of times that are no outliers. Simulated holds of blocks and a limb are within 0.002 of
# their fit, except for single steps.
_MISFIT, _STRAY, _MOST_FAIR = 0.02, 0.01, 0.85


@dataclass(frozen=True, eq=False)
class HeldIndentation:
    """A simulated indentation, pressed in while k c t rises to `ramp` and held from then on.

    depth : mm
    ramp : mm^2
    spread : (n,) k c t in mm^2, increasing
    force : (n,) N
    """

    depth: float
    ramp: float
    spread: Array
    force: Array


@dataclass(frozen=True, eq=False)
class Drainage:
    """Drainage of a site.

    depth : (n_depths,) mm, increasing
    lost : (n_depths, n_terms) the fractions s_i
    spread : (n_terms,) the x_i (mm^2)
    """

    depth: Array
    lost: Array
    spread: Array

    @staticmethod
    def through(holds: Sequence[HeldIndentation]) -> Drainage:
        """Fit the fractions to simulated holds, one hold per depth.

        Raises SolveError if there is no hold, or if one has too few usable times or does not decay like
        draining tissue.
        """
        if not holds:
            raise SolveError("no held indentation was simulated", where="drainage", fix="see why in its log")
        ordered = sorted(holds, key=lambda each: each.depth)
        lost = np.array([_shares(each) for each in ordered])
        return Drainage(np.array([each.depth for each in ordered]), lost, SPREADS)

    def times(self, rate: float) -> Array:
        """Time constants (n_terms,) in s for a k c of `rate` (mm^2/s)."""
        return np.asarray(self.spread / max(abs(rate), 1e-12))

    def left(self, depth: Array, memory: Array, rate: float) -> Array:
        """Fraction (n,) of the undrained force that remains at depths (n,) mm.

        memory : (n, n_terms) the m_i (mm), with time constants `times(rate)`

        A rate below 0 occurs only in finite differences about 0; there the force increases by as much as it
        decreases at the opposite rate.
        """
        shares = np.column_stack([np.interp(depth, self.depth, each) for each in self.lost.T])
        gone = shares * (1.0 - memory / np.maximum(depth, _LEAST_DEPTH)[:, None])
        return np.maximum(1.0 - np.sign(rate) * gone.sum(axis=1), _LEAST_LEFT)


def held_memory(hold: HeldIndentation, spread: Array) -> Array:
    """m_i / d (n, n_terms) of a hold, from the end of its ramp on."""
    at_end = spread / hold.ramp * -np.expm1(-hold.ramp / spread)
    return np.asarray(at_end * np.exp(-np.maximum(hold.spread - hold.ramp, 0.0)[:, None] / spread))


def _shares(hold: HeldIndentation) -> Array:
    """Fractions (n_terms,) by non-negative least squares of the relative force, from the first term's time
    on."""
    used = hold.spread >= max(hold.ramp, SPREADS[0])
    force = hold.force[used]
    if used.sum() < _ENOUGH_POINTS or not np.all(force > 0):
        raise SolveError(
            f"the hold at {hold.depth:g} mm has {int(used.sum())} usable times",
            where="drainage", fix="check the log of the run",
        )  # fmt: skip
    gone = 1.0 - held_memory(hold, SPREADS)[used]
    table = np.column_stack([np.ones(len(force)), -gone]) / force[:, None]
    from scipy.optimize import nnls

    off = _misfit(table, nnls(table, np.ones(len(force)))[0])
    # A time step accepted before full convergence appears as a single outlier.
    fair = off <= max(_STRAY, 5.0 * float(np.median(off)))
    found = nnls(table[fair], np.ones(int(fair.sum())))[0]
    worst = float(_misfit(table[fair], found).max())
    if found[0] <= 0 or worst > _MISFIT or fair.mean() < _MOST_FAIR:
        raise SolveError(
            f"the force of the hold at {hold.depth:g} mm does not decay like that of "
            f"draining tissue ({100 * float(off.max()):.0f} % off)",
            where="drainage", fix="check the log of the run and the site's mesh",
        )  # fmt: skip
    return np.asarray(found[1:] / found[0])


def _misfit(table: Array, found: Array) -> Array:
    return np.asarray(np.abs(table @ found - 1.0))
