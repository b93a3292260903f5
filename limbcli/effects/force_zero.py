"""The force reading has a constant offset: F_shown = F + F0.

F0 = m g (cos theta - cos theta_tare) for a probe of 0.2 to 0.4 kg whose load cell was tared in another
position; at most 4 N.
Tell-tale: a vertical shift of the whole force-depth curve; speed over depth is unchanged.
Source: statics of a tilted load cell.
"""

from __future__ import annotations

from limbcli.effects.effect import Effect, Parameter, adds_to

ZERO = Parameter("force_zero_n", null=0.0, start=0.5, low=-4.0, high=4.0, typical=1.0,
                 prior="probe of 0.2 to 0.4 kg, tilted", reported="f0_n")  # fmt: skip

EFFECT = Effect(
    name="force-zero",
    sentence="the force reads off by a constant (tare, weight of the probe)",
    kind="measurement",
    source="statics of a tilted load cell",
    parameters=(ZERO,),
    observe=adds_to("force_zero", ZERO),
    each_time=True,
)
