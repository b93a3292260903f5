"""The force reads too large or too small by a factor: F_shown = g F.

Load cells of this kind are accurate to 5 %. The factor cannot be separated from the scale of c unless the
shear-wave speeds determine c.
Tell-tale: the force scale differs from what the wave speeds indicate.
Source: calibration of load cells.
"""

from __future__ import annotations

from limbcli.effects.effect import Effect, Parameter, multiplies

GAIN = Parameter(
    "force_gain", null=1.0, start=1.03, low=0.9, high=1.1, typical=1.05, prior="calibration within 5 %"
)

EFFECT = Effect(
    name="force-gain",
    sentence="the force reads too large or too small by a factor",
    kind="measurement",
    source="calibration of load cells",
    parameters=(GAIN,),
    observe=multiplies("force_gain", GAIN),
)
