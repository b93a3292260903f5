"""Between probe and bone shear waves are guided and run faster than in unbounded tissue.

Motion along the beam is suppressed at both: v_shown = v / sqrt(1 - (v / (2 h f))^2), h the remaining
thickness, f the frequency (50 to 500 Hz). Thin sites and large loads read too high, which resembles a larger
m.
Tell-tale: additional rise of the speed at large load, more at thin sites.
Source: Graff 1975, Wave Motion in Elastic Solids, chapter 8 (cut-off of a layer with held faces).
"""

from __future__ import annotations

import math

from limbcli.effects.effect import Effect, Parameter, adds_to


def cut_off_hz(guided: float, c_kpa: float) -> float:
    """Frequency below which waves are guided."""
    return 100.0 / math.sqrt(guided) if guided > 0 else math.inf


GUIDED = Parameter("guided_1e4_per_hz2", null=0.0, start=0.1, low=0.0, high=4.0, typical=0.25,
                   prior="f 50 to 500 Hz: 4 to 0.04", reported="f_c_hz", turn=cut_off_hz)  # fmt: skip

EFFECT = Effect(
    name="swe-guided-wave",
    sentence="shear waves are guided between probe and bone and read too fast",
    kind="swe",
    source="Graff 1975, Wave Motion in Elastic Solids, chapter 8 (cut-off of a layer with held faces)",
    parameters=(GUIDED,),
    needs=("swe", "bone"),
    observe=adds_to("guided", GUIDED),
)
