"""Depth is not counted from first touch: d_true = d_shown + d0.

The first frame may be compressed already (d0 > 0), or the probe touches only in part.
Tell-tale: a horizontal shift; the toe is cut or stretched; speed over depth shifts too.
Source: first-frame selection on B-mode images.
"""

from __future__ import annotations

from dataclasses import replace

from limbcli.effects.base import Effect, Parameter, Theta
from limbcli.effects.reading import Reading

ZERO = Parameter(
    "depth_zero_mm",
    null=0.0,
    start=0.5,
    low=-3.0,
    high=3.0,
    typical=1.0,
    prior="0.5 to 2 mm by eye on a B-mode frame",
)


def observe(reading: Reading, theta: Theta) -> Reading:
    return replace(reading, depth_zero=reading.depth_zero + theta[ZERO.name])


EFFECT = Effect(
    name="depth-zero",
    sentence="depth is not counted from first touch",
    kind="measurement",
    source="first-frame selection on B-mode images",
    parameters=(ZERO,),
    needs=("force",),
    observe=observe,
    each_time=True,
    tell_tale="a horizontal shift; the toe is cut or stretched; speed over depth shifts too",
)
