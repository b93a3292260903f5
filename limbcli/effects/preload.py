"""The probe already pressed on the skin when force and depth were set to zero.

F_shown(d) = F(d + d0) - F0, with F(d0) = F0, 0 to 2 N. The tissue is stretched at level 0, so the speed there
is not that of the tissue at rest, and c = 2 rho v0^2 is too high. The tissue is assumed to be in equilibrium
under F0, so only what the levels add relaxes and drains later. In a model file the load begins at d0; a
resident stretch of the tissue itself would be a `prestrain elastic`.
Tell-tale: the toe is missing; the speed at level 0 is that of compressed tissue.
Source: Gennisson et al. 2007, J Acoust Soc Am 122:3211 (stretched tissue carries waves faster).
"""

from __future__ import annotations

from limbcli.effects.effect import Effect, Parameter, adds_to

PRELOAD = Parameter("preload_n", null=0.0, start=0.5, low=0.0, high=3.0, typical=0.7,
                    prior="0 to 2 N: weight of the probe, contact through gel", reported="f0_n")  # fmt: skip

EFFECT = Effect(
    name="preload",
    sentence="the probe was already pressing when force and depth were zeroed",
    kind="tissue",
    source="Gennisson et al. 2007, J Acoust Soc Am 122:3211 (stretched tissue carries waves faster)",
    parameters=(PRELOAD,),
    observe=adds_to("preload", PRELOAD),
    each_time=True,
)
