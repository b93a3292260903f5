"""All decision thresholds of a diagnosis in one table: value, meaning and source.

"Convention" marks the field's usual level. "Assumed" marks a value without a measurement behind it. "Chosen"
marks a value set by hand, tuned only on the simulated limbs with and without hidden effects that the tests
evaluate (`tests/diagnostics/test_hidden_set.py`, `test_reduced_site.py`): run these after changing one.
Sizes of the noise itself are not thresholds; they are defined with the readings
(`stages.diagnosis.data.noise`).
"""

from __future__ import annotations

from typing import Final

# ------------------------------------------------ detection: is the residual significant?

ALPHA: Final = 0.05
"""False-alarm rate of the whole family of tests on the fit without effects. Convention."""

ROUGH_P: Final = 0.01
"""p of the scatter about smooth curves below which the stated noise is taken as contradicted and the tests
become relative (independent of the noise level). Chosen."""

GROSS: Final = 4.0
"""chi2/nu above which the fit without effects is grossly wrong and all candidates are refitted. An effect
that reduces chi2 by this factor then needs no further evidence. Chosen."""

FEW_DATA: Final = 40
"""Largest number of data in a group for which a localisation test shifts each datum separately. Chosen."""

N_DRAWS: Final = 5000
"""Draws in the first batch for a family's adjusted p. Among 30 tests, one with an adjusted p of 0.05 has 8
draws at least as extreme. Chosen, to limit run time."""

MOST_BATCHES: Final = 16
"""Largest number of batches of `N_DRAWS` draws, used where an adjusted p is near a decision level. Chosen, to
limit run time: the 8 draws become 130, and the standard deviation of a p of 0.05 falls from 0.018 to
0.005."""

CLEAR_SD: Final = 2.0
"""Monte Carlo standard deviations of an adjusted p within which it counts as near a decision level.
Convention."""

# ------------------------------------------------ identification: which candidates are refitted

REFIT_BELOW: Final = 0.2
"""Adjusted p below which a candidate is refitted: four times ALPHA, as first-order tests are unreliable for
strong effects. Chosen."""

ALIKE: Final = 0.8
"""Cosine between sensitivities above which two effects are so similar in these data that both are refitted.
Chosen."""

MAX_REFITS: Final = 16
"""Largest number of candidates refitted. Chosen, to limit run time."""

GROWN: Final = 3
"""Candidates added in turn to the best smaller explanation. Chosen, to limit run time."""

PAIRS_KEPT: Final = 12
"""Pairs refitted, those with the highest joint score. Chosen, to limit run time."""

EXCHANGED: Final = 3
"""Explanations by several effects for which one effect is replaced by similar ones. Chosen, to limit run
time."""

LOOK_ALIKES: Final = 8
"""Largest number of such replacements. Chosen, to limit run time."""

HOPELESS: Final = 20.0
"""Deviance above that of the best surrogate fit beyond which an explanation is not simulated. Chosen."""

MOST_SIMULATED: Final = 4
"""Explanations by several effects that are simulated, those with the lowest deviance; explanations that need
no simulation of their own are not counted. Chosen, to limit run time."""

# ------------------------------------------------ the confidence set: which explanations cannot be excluded

ADEQUATE: Final = 0.005
"""Smallest p of the remaining residual at which an explanation is adequate. Below ALPHA, as the model's own
error is known only roughly. Chosen: equivalent to the earlier threshold of 0.01 with 4,000 draws, where no
draw as extreme gave p = 0.0075 and one gave 0.015, so that an explanation with a p of 0.005 was accepted half
of the time."""

BARELY: Final = 0.25
"""Fraction of ADEQUATE down to which an explanation is still kept if it fits as well as a member of the set.
Chosen."""

BORNE_OUT: Final = 0.5
"""Share of the reduction of deviance that a first-order score promises, below which a further effect's refit
does not bear it out, and the next ones are tried. Chosen."""

AS_WELL: Final = 4.0
"""Difference of deviance within which one explanation fits as well as another. Chosen."""

BEATEN: Final = 0.01
"""Significance level of the test of an explanation against the best of the set. Chosen, as ADEQUATE."""

SLACK: Final = 0.5
"""Difference of deviance within which two fits are equivalent, regardless of the drawn quantile. Chosen."""

N_DRAWS_OF_GAPS: Final = 4000
"""Draws of the deviance gap between two explanations, enough for its 99 % quantile. Chosen, to limit run
time."""

SECOND: Final = 0.15
"""Adjusted p of a member's remaining residual below which one further effect is added to it. Chosen between
ALPHA and REFIT_BELOW: the evidence for a second effect is weak once the first has changed c and m."""

NEEDED: Final = 2.0
"""Smallest reduction of deviance by one of several effects whose removal leaves an adequate explanation:
Akaike's criterion for one parameter. Convention."""

# ------------------------------------------------ model-form error of an effect

OF_FORM: Final = 0.02
"""Fraction of the deviance changed by an effect that may remain as residual, as no model of an effect matches
the limb exactly. Assumed."""

FORM_ERROR: Final = 0.05
"""Standard deviation of the form error in forces and mean speeds, as a fraction of the effect's own change.
Assumed."""

FORM_ALIKE: Final = 0.8
"""Correlation of the form error between neighbouring levels. Assumed."""

IMAGE_ERROR: Final = 0.15
"""Standard deviation of the form error in an image, as a fraction of the effect's own change; larger because
edges are displaced. Assumed."""

IMAGE_WIDE_MM: Final = 4.0
"""Correlation length of the form error in an image, in mm. Assumed: about one part of a map."""

IMAGE_ALIKE: Final = 0.97
"""Correlation of the form error in an image between neighbouring levels. Assumed."""

# ------------------------------------------------ adaptation: is an effect named, and is the gap closed?

LEFT: Final = ALPHA
"""p of the remaining residual below which the only explanation is not named: a named effect may leave no
residual that would be detected. Where a further effect explains the residual, the first may be half of a
pair."""

NAMED: Final = 0.02
"""p of the evidence for an effect, adjusted over the effects, from which it is not named, even if nothing
else fits: with ALPHA, one in twenty limbs without any effect would reach this point. Chosen, after a p of
0.043 (over all tests) had named a wrong effect."""

NAMED_BY_GAIN: Final = 1000.0
"""Factor on the p of a refit's gain in that decision: this p assumes normal errors of known size, which model
errors are not. Chosen, after a factor of 10 had named an effect on a randomly drawn limb without one (a gain
of 22 where the first-order statistic was 12)."""

CLOSED_PERCENTILE: Final = 95.0
"""Percentage of placebos (arbitrary smooth curves, each the best of as many as there are candidates) that a
named effect must exceed. Convention."""

CLOSED_BY_SEVERAL_PERCENTILE: Final = 99.0
"""The same for several effects, whose placebos are the best of as many combinations. Chosen."""

MOST_NAMED: Final = 2
"""Largest number of effects that can be named: three can fit almost any smooth residual. Chosen."""

MOST_PICKED: Final = 100
"""Largest number of combinations from which a placebo is selected. Chosen, to limit run time."""

N_PLACEBOS: Final = 1000
"""Number of placebos: gives the 95th percentile with a standard deviation of 0.7. Chosen, to limit run
time."""

TOO_WIDE: Final = 1.0
"""Ratio of the standard deviation of a prediction to that of its reading above which a held-out block is not
tested: its error is then mostly due to parameters that the other data do not determine. Chosen."""

# ------------------------------------------------ what is reported

WITHIN: Final = 3.84
"""Deviance above the minimum within which a value belongs to a parameter's interval: 95 %, one parameter.
Convention (chi2 with one degree of freedom)."""

MAP_INTERVAL_FACTOR: Final = 1.35
"""Factor by which the intervals of c and m (in ln) and of effect sizes are widened where maps determine them:
the model error in maps is set to its maximum-likelihood size, and the root-mean-square errors of c and m
exceeded the reported ones by this factor at sites simulated with another solver
(`tests/benchmarks/figures/diagnosis-febio.md`). Chosen."""

SIZE_WITHIN: Final = 1.96
"""Half-width of the 95 % interval of an effect's size, in standard deviations. Convention (normal
distribution)."""

F_KAPPA_ERROR: Final = 0.7
"""Root-mean-square error of f_kappa as it is estimated beside c and m, in standard deviations of its prior.
At thirteen sites of the FEBio study with maps and nothing hidden it is 0.68, where its own deviation is 0.2:
errors of the models in maps resemble compressibility (`tests/benchmarks/figures/diagnosis-parts.md`).
Chosen, as measured."""

PULLED: Final = 0.1
"""Change of ln m above which the prior counts as having moved m. Chosen."""

POWER: Final = 0.8
"""Power at which an effect's size counts as detectable. Convention."""

BIAS_MATTERS_SD: Final = 1.0
"""Bias of c or m from an undetected effect, in their standard deviations, above which it is reported.
Chosen."""

NEXT_SIGNIFICANT: Final = 0.95
"""1 - significance level of the one-sided test between two explanations after the next measurement.
Convention."""

NEXT_POWER: Final = 0.5
"""Smallest power at which a next measurement is recommended. Chosen."""

# ------------------------------------------------ uncertainty of the simulation and of the readings

MATTERS_SD: Final = 0.3
"""Change of the data by mesh, cut, contact or compressibility, in standard deviations, above which the report
calls it significant. Chosen."""

DOUBTFUL: Final = 0.15
"""Numerical uncertainty in ln force, as it enters the noise, above which the verdict is called uncertain.
Chosen."""

ON_BOUND: Final = 1e-3
"""Distance from a bound, as a fraction of the parameter's range, within which it counts as on the bound.
Numerical."""

FALLEN_SD: Final = 4.0
"""Fall of the force over all holds, in standard deviations, from which holds count as recorded relaxation if
the depth was not recorded, and from which drainage is simulated. Chosen."""

RAMP_SD: Final = 5.0
"""Slope in standard deviations of its own noise from which it counts as a ramp. Chosen."""

DEPTH_OUTLIER_SD: Final = 4.0
"""Largest error of a depth reading that is corrected, in standard deviations of the reading. Chosen."""
