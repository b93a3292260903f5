"""Shear waves probe the tissue at 100 to 400 Hz, the force over seconds: c = 2 s mu_SWE.

Kelvin-Voigt: rho v^2 = 2 (mu^2 + w^2 eta^2)/(mu + sqrt(mu^2 + w^2 eta^2)); tissue is stiffer at high
frequency, so s < 1. All speeds are off by the same factor; their variation with depth is right.
Tell-tale: force and speeds require different c, while the shape of speed over depth fits.
Source: Klatt et al. 2010, Phys Med Biol 55:6445.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.reading import Reading

SCALE = Parameter("swe_modulus_scale", null=1.0, start=0.8, low=0.1, high=1.2, typical=0.7,
                  prior="dispersion of muscle: 0.5 to 1", reported="s_t")  # fmt: skip


def observe(reading: Reading, theta: Theta) -> Reading:
    shift = -0.5 * float(np.log(theta[SCALE.name]))
    return replace(reading, log_speed_shift=reading.log_speed_shift + shift)


EFFECT = Effect(
    name="swe-time-scale",
    sentence="shear waves measure a different stiffness than slow loading: one factor on all speeds",
    kind="swe",
    source="Klatt et al. 2010, Phys Med Biol 55:6445",
    parameters=(SCALE,),
    needs=("force", "swe"),
    observe=observe,
)
