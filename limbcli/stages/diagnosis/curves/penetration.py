"""How far a penalty lets the probe sink into the model's skin, and the curves without that.

A gap g = p/eps works in series with the tissue: the same force is reached deeper by g. Two penalties
tell g over the force. Over force it depends far less on the law's exponent than the force itself does (at the
same force at most 1.8 times as much at m 2 as at m 10, a fifth over thin tissue), so that one pair of
simulations, at the tissue's likely m, corrects the curves of laws near it and of effects, by a shift of their
depth.

Source: series compliance of the penalty's gap; extrapolated as a geometric series (Richardson).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from limbcli.effects.curves import Curves, depth_at, log_force_at
from limbcli.model import Array

# Of the shift between a penalty and a quarter of it, what the harder one still leaves, and one deviation of
# that share: a third where the gap is proportional to 1/eps; four times the penalty took 0.33 to 0.43
# of what the step before took, which comes to 0.5 to 0.7 if it goes on so.
_LEFT, LEFT_ERROR = 0.5, 0.15
_POWER = 0.8  # of 1/eps, with which the gap goes: a quarter of the penalty triples it
_LEAST_STEP = 0.05  # of a step between two depths, after the shift


@dataclass(frozen=True, eq=False)
class Penetration:
    """Depth (n,) in mm by which the probe has sunk in at forces (n,) in N, from (0, 0) on; beyond the last
    force in proportion to it. Forces are those at the simulations' reference stiffness."""

    force: Array
    depth: Array

    def at(self, force: Array) -> Array:
        beyond = np.maximum(force / self.force[-1], 1.0)
        return np.asarray(np.interp(force, self.force, self.depth) * beyond)

    def without(self, curves: Curves, force: Array) -> Curves:
        """The curves as a hard contact gives them; force (n,) in N at the reference stiffness."""
        shifted = curves.depth - self.at(force)
        steps = np.maximum(np.diff(shifted), _LEAST_STEP * np.diff(curves.depth))
        return replace(curves, depth=np.concatenate([curves.depth[:1], curves.depth[0] + np.cumsum(steps)]))

    def taken(self, curves: Curves, force: Array, depth: float, *, penalty: float) -> float:
        """The share of the force that a contact takes from these curves of a hard one, at a depth in mm.

        force (n,) : at the reference stiffness; penalty : in units of the one whose gap is known
        """
        softer = replace(curves, depth=curves.depth + self.at(force) * penalty**-_POWER)
        at = np.array([depth])
        return float(1.0 - np.exp(log_force_at(softer, at) - log_force_at(curves, at))[0])


def penetration(harder: Curves, softer: Curves) -> Penetration | None:
    """What `harder` still sinks in, by what `softer`, of a quarter of its penalty, sinks in further.

    None where the two do not determine it (the softer contact gives no less force).
    """
    rising = np.flatnonzero((np.diff(softer.force, prepend=0.0) > 0) & (softer.depth > 0))
    if len(rising) < 2:
        return None
    force = softer.force[rising]
    further = softer.depth[rising] - depth_at(harder, force)
    if further[-1] <= 0:
        return None
    return Penetration(np.r_[0.0, force], np.r_[0.0, _LEFT * np.maximum(further, 0.0)])
