"""Depth is not counted from first touch: d_true = d_shown + d0.

The first frame may already be compressed (d0 > 0), or the probe may touch only in part. Alternatively the
level shown at depth 0 was at first touch but its skin-bone distance was misread; then all other depths are
off by d0.
Tell-tale: a horizontal shift; the toe is cut or stretched; speed over depth shifts too.
Source: first-frame selection on B-mode images.
"""

from __future__ import annotations

from dataclasses import replace

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.reading import Reading

ZERO = Parameter("depth_zero_mm", null=0.0, start=0.5, low=-3.0, high=3.0, typical=1.0,
                 prior="0.5 to 2 mm by eye on a B-mode frame", reported="d0_mm")  # fmt: skip
TOUCHES = "depth_0_is_first_touch"  # 1: it is; 0: it is off by d0 like the others


def observe(reading: Reading, theta: Theta) -> Reading:
    if theta[ZERO.name] == 0.0:
        return reading
    zero = reading.depth_zero + theta[ZERO.name]
    return replace(reading, depth_zero=zero, touches_at_zero=bool(theta.get(TOUCHES, 0.0)))


EFFECT = Effect(
    name="depth-zero",
    sentence="depth is not counted from first touch",
    kind="measurement",
    source="first-frame selection on B-mode images",
    parameters=(ZERO,),
    observe=observe,
    grid=({TOUCHES: 0.0}, {TOUCHES: 1.0}),
    each_time=True,
)
