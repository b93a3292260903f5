"""Penetration of the probe into the model's skin due to the contact penalty, and curves corrected for it.

A gap g = p/eps acts as a compliance in series with the tissue: the same force is reached deeper by g. Two
penalties determine g as a function of force. This function depends far less on the law's exponent than the
force itself does (at the same force at most 1.8 times as much at m 2 as at m 10, a fifth over thin tissue),
so that one pair of simulations, at the tissue's likely m, corrects the curves of similar laws and of effects
by a shift of their depth.

Source: series compliance of the penalty's gap; extrapolated as a geometric series (Richardson).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from limbcli.effects.curves import Curves, depth_at, log_force_at
from limbcli.model import Array

# Remaining gap of the harder contact, as a fraction of the depth shift between a penalty and a quarter of it,
# and the standard deviation of this fraction. It is a third if the gap is proportional to 1/eps. Each further
# increase of the penalty by four shifted the depth by 0.33 to 0.43 of the previous shift, which extrapolates
# to 0.5 to 0.7.
_LEFT, LEFT_ERROR = 0.5, 0.15
_POWER = 0.8  # exponent of the gap in 1/eps: a quarter of the penalty triples the gap
_LEAST_STEP = 0.05  # smallest step between two depths after the shift, as a fraction of that before


@dataclass(frozen=True, eq=False)
class Penetration:
    """Penetration depth (n,) in mm of the probe at forces (n,) in N, starting at (0, 0); proportional to the
    force beyond the last one. Forces are those at the simulations' reference stiffness."""

    force: Array
    depth: Array

    def at(self, force: Array) -> Array:
        beyond = np.maximum(force / self.force[-1], 1.0)
        return np.asarray(np.interp(force, self.force, self.depth) * beyond)

    def without(self, curves: Curves, force: Array) -> Curves:
        """The curves for a hard contact, without penetration; force (n,) in N at the reference stiffness."""
        shifted = curves.depth - self.at(force)
        steps = np.maximum(np.diff(shifted), _LEAST_STEP * np.diff(curves.depth))
        return replace(curves, depth=np.concatenate([curves.depth[:1], curves.depth[0] + np.cumsum(steps)]))

    def taken(self, curves: Curves, force: Array, depth: float, *, penalty: float) -> float:
        """Relative reduction of the force by a penalty contact compared with hard contact, at a depth in mm.

        curves : for hard contact; force (n,) : of these at the reference stiffness
        penalty : in units of the one whose gap is known
        """
        softer = replace(curves, depth=curves.depth + self.at(force) * penalty**-_POWER)
        at = np.array([depth])
        return float(1.0 - np.exp(log_force_at(softer, at) - log_force_at(curves, at))[0])


def penetration(harder: Curves, softer: Curves) -> Penetration | None:
    """Penetration of `harder`, extrapolated from that of `softer`, which has a quarter of its penalty.

    None if the two do not determine it (the softer contact gives no less force).
    """
    rising = np.flatnonzero((np.diff(softer.force, prepend=0.0) > 0) & (softer.depth > 0))
    if len(rising) < 2:
        return None
    force = softer.force[rising]
    further = softer.depth[rising] - depth_at(harder, force)
    if further[-1] <= 0:
        return None
    return Penetration(np.r_[0.0, force], np.r_[0.0, _LEFT * np.maximum(further, 0.0)])
