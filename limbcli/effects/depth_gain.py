"""Depth reads too large or too small by a factor: d_true = g d_shown.

The scanner assumes 1540 m/s; fat has about 1450, muscle 1580: g 0.94 to 1.03. All distances along the beam
are misread by the same factor, including that from skin to bone.
Tell-tale: force and speed are both stretched over depth.
Source: Goss et al. 1978, J Acoust Soc Am 64:423 (speeds of sound in tissue).
"""

from __future__ import annotations

from limbcli.effects.effect import Effect, Parameter, multiplies

GAIN = Parameter("depth_gain", null=1.0, start=1.02, low=0.93, high=1.05, typical=1.03,
                 prior="sound speed 1450 to 1580 m/s")  # fmt: skip

EFFECT = Effect(
    name="depth-gain",
    sentence="depth reads too large or too small by a factor (speed of sound)",
    kind="measurement",
    source="Goss et al. 1978, J Acoust Soc Am 64:423 (speeds of sound in tissue)",
    parameters=(GAIN,),
    observe=multiplies("depth_gain", GAIN),
)
