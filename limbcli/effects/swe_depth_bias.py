"""The scanner's speeds depend on the depth of the reading: v_shown = v (1 - b (z - z_true)).

Causes are push strength, depth of focus and attenuation: in a phantom-like muscle one scanner and probe gave
4.6 m/s at shallow depth and 1.8 m/s at large depth. At which depth it reads right is not known either: beside
a loss of 2 % per mm, 5 mm there change all speeds by a tenth and c by a fifth, which only the force shows.
Tell-tale: a gradient with depth below the face that is the same at all loads.
Source: PMC6148312 (depth dependence of one scanner and probe in muscle).
"""

from __future__ import annotations

from dataclasses import replace

from limbcli.effects.effect import Effect, Parameter, Theta
from limbcli.effects.reading import Reading

SLOPE = Parameter("swe_loss_per_mm", null=0.0, start=0.005, low=-0.03, high=0.03, typical=0.01,
                  prior="0 to 3 % per mm", reported="beta_per_mm")  # fmt: skip
READS_RIGHT = Parameter.of_shape("swe_reads_right_at_mm", 13.5, 0.0, 27.0, "within the depths of a map")


def observe(reading: Reading, theta: Theta) -> Reading:
    if not theta[SLOPE.name]:  # without a bias it reads right everywhere
        return reading
    right = theta.get(READS_RIGHT.name, READS_RIGHT.start)
    return replace(reading, speed_slope=reading.speed_slope + theta[SLOPE.name], reads_right_at=right)


EFFECT = Effect(
    name="swe-depth-bias",
    sentence="the scanner reads deep tissue differently from shallow tissue",
    kind="swe",
    source="PMC6148312 (depth dependence of one scanner and probe in muscle)",
    parameters=(SLOPE, READS_RIGHT),
    needs=("map",),
    observe=observe,
)
