"""All numbers that a diagnosis decides by: value, meaning and source.

Sizes of the noise and of the model's errors are no decisions; they are defined with the readings
(`diagnosis.data.noise_parts`), and the priors of effects with the effects.
"""

from __future__ import annotations

from typing import Final

SOMETHING_MISSING: Final = 0.5
"""Prior probability that one effect is missing rather than nothing, divided evenly among the effects that can
be evaluated; a pair has the product of its effects' shares. By the principle of indifference."""

CREDIBLE: Final = 0.95
"""Probability of the reported set of explanations, of an effect that is named, and of all intervals.
Convention."""

FALSE_ALARMS: Final = 0.05
"""Share of the measurements with nothing missing whose probability of "nothing" is as low by chance, from
which the model is not adequate: what probability that is, is computed at each site (`least_by_chance`). Also
the adjusted p below which a part of the data is reported as not described, and nothing is named that leaves
such a part. Convention."""

CHECKED: Final = 0.01
"""p of the posterior predictive check, adjusted over the whole and all parts of the data, below which even
the most probable explanation does not describe the data. Convention."""

UNSETTLED: Final = 0.05
"""Largest probability of an explanation that stays with an estimate by linear extension, without a fit and
simulation of its own: together with `CREDIBLE` it keeps every explanation that could be named apart from
these. Chosen as 1 - CREDIBLE."""

N_DRAWS: Final = 1000
"""Draws from the noise in the calibration of the adequate level: a share of 0.05 has a standard deviation of
0.007. Chosen, to limit run time."""

N_DRAWS_OF_PARTS: Final = 5000
"""Draws for the adjusted p of the parts of the data: at 0.01 a standard deviation of 0.0014. Chosen, to limit
run time."""

ROUGH_P: Final = 0.01
"""p of the scatter about smooth curves below which the stated noise is taken as contradicted: its level is
then estimated in every explanation. Convention."""

POWER: Final = 0.8
"""Power at which an effect's size counts as detectable. Convention."""

BIAS_MATTERS_SD: Final = 1.0
"""Bias of c or m from an undetected effect of plausible size, in their standard deviations, from which it is
reported. Convention: as large as the random error."""

MATTERS_SD: Final = 0.3
"""Change of the data by mesh, cut, contact or compressibility, in standard deviations, from which the report
calls it significant: it then adds 5 % to the standard deviation. Computed."""

FALLEN_SD: Final = 4.0
"""Fall of the force over all holds, in standard deviations, from which holds without a recorded depth count
as relaxation, and from which drainage is simulated: one in 30,000 records by chance. Convention."""
