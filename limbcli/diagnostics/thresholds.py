"""Every number by which a diagnosis decides, in one table: value, meaning, and where it comes from.

"Convention" is the field's usual level. "Assumed" has no measurement behind it. "Chosen" was set by hand,
with no other source than the simulated limbs with and without hidden effects that the tests judge
(`tests/diagnostics/test_hidden_set.py`, `test_reduced_site.py`): whoever changes such a value runs them.
Sizes of the noise itself are no thresholds: they stand with the readings (`stages.diagnosis.data.noise`).
"""

from __future__ import annotations

from typing import Final

# ------------------------------------------------ detection: is anything left beyond chance?

ALPHA: Final = 0.05
"""False-alarm rate of the whole family of tests on the fit without effects. Convention."""

ROUGH_P: Final = 0.01
"""p of the scatter about smooth curves, below which the stated noise is contradicted and the tests become
relative. Chosen."""

GROSS: Final = 4.0
"""chi2/nu above which the fit without effects is grossly wrong and all candidates are refitted; an effect
that divides it by as much is evidence of its own. Chosen."""

FEW_DATA: Final = 40
"""Data of a group up to which each is shifted on its own in a localisation test. Chosen."""

N_DRAWS: Final = 5000
"""Draws behind a family's adjusted p, at first. Of 30 tests, one with an adjusted p of 0.05 has 8 draws as
extreme. Chosen, for time."""

MOST_BATCHES: Final = 16
"""Times that many draws that are made at most, where an adjusted p is near one by which something is decided.
Chosen, for time: the 8 draws become 130, and the deviation of a p of 0.05 falls from 0.018 to 0.005."""

CLEAR_SD: Final = 2.0
"""Deviations of an adjusted p, by the number of draws, within which it is near. Convention."""

# ---------------------------------------- before detection: are the bones where they are said to be?
# These were chosen with the reference data's sites that FEBio made in view, which are no test of them.

BONES_SEEN: Final = 12.0
"""Gain of deviance (-2 ln likelihood, readings that both limbs predict) from which on a limb without a small
bone is taken for the limb that was segmented: prior odds of one in 400 against it. Chosen."""

BONES_MISPLACED: Final = 6.0
"""The same for bones that lie outside the skin, so that the limb is wrong as it was segmented: odds of one in
20 against the place that was found for them. Chosen."""

BONES_REMESHED: Final = 0.065
"""Deviance a reading by which both are raised: what another mesh of the same limb may gain. Numerical, seen
once: bones 0.06 mm apart gave deviances 35 apart over 549 readings."""

BONES_DECISIVE: Final = 60.0
"""Such a gain by a limb that leaves nothing is believed before any effect is looked at; a smaller one has to
exceed that of the best single effect on the limb as segmented. Chosen."""

BONES_HOPELESS: Final = 1.5
"""Depth misfit of a limb with other bones over that of the limb as segmented (or the depths' noise, if
that is more), above which its first force curves are enough to give it up. Chosen, for time."""

BONES_LOOKED_AT: Final = 0.2
"""p of the fit without effects, below which a limb with other bones is looked at: four times ALPHA, as chi2
over all readings shows one cause late. Chosen."""

BONES_ABSORBED: Final = 0.7
"""Share of the largest error of a model in maps, beyond which it is looked at, too: what is wrong with the
limb may have gone into that error. Chosen: where bones were right it was 0.38 to 0.65 (other tissue 0.9)."""

# ------------------------------------------------ identification: what is refitted

REFIT_BELOW: Final = 0.2
"""Adjusted p below which a candidate is refitted: four times ALPHA, as first order is a poor guide to
strong effects. Chosen."""

ALIKE: Final = 0.8
"""Cosine above which two effects look the same in these data, so that both are refitted. Chosen."""

MAX_REFITS: Final = 16
"""Candidates refitted at most. Chosen, for time."""

GROWN: Final = 3
"""Candidates tried beside the best smaller explanation. Chosen, for time."""

PAIRS_KEPT: Final = 12
"""Pairs refitted, by their score together. Chosen, for time."""

EXCHANGED: Final = 3
"""Explanations by several effects, one of whose effects is exchanged for its look-alikes.
Chosen, for time."""

LOOK_ALIKES: Final = 8
"""Such exchanges at most. Chosen, for time."""

HOPELESS: Final = 20.0
"""Deviance behind the best fit on the surrogate, beyond which an explanation is not simulated. Chosen."""

MOST_SIMULATED: Final = 4
"""Explanations by several effects that are simulated, those with the least deviance; what needs no simulation
of its own is judged besides. Chosen, for time."""

# ------------------------------------------------ the confidence set: what cannot be excluded

ADEQUATE: Final = 0.005
"""p of what an explanation leaves, from which on it is adequate. Below ALPHA, as the model's own error is
known only roughly. Chosen: what 0.01 came to while 4,000 draws stood behind it, of which none as extreme gave
0.0075 and one 0.015, so that an explanation with 0.005 was taken half of the time."""

BARELY: Final = 0.25
"""Share of ADEQUATE down to which an explanation still counts where it fits as well as a member. Chosen."""

AS_WELL: Final = 4.0
"""Deviance within which it fits as well. Chosen."""

BEATEN: Final = 0.01
"""Level of the test of an explanation against the best of the set. Chosen, as ADEQUATE."""

SLACK: Final = 0.5
"""Deviance within which two fits are the same, whatever the draws say. Chosen."""

N_DRAWS_OF_GAPS: Final = 4000
"""Draws of the gap of deviance between two explanations: enough for its 99 % quantile. Chosen, for time."""

SECOND: Final = 0.15
"""Adjusted p of what a member leaves, below which one effect more is tried with it. Chosen between ALPHA and
REFIT_BELOW: of two effects the second is weak evidence once the first has moved c and m."""

# ------------------------------------------------ the error of an effect's form

OF_FORM: Final = 0.02
"""Share of the deviance that an effect changes, which it may leave, as no model of it is just that of the
limb. Assumed."""

FORM_ERROR: Final = 0.05
"""Deviation of the form's error in forces and mean speeds, a share of the effect's own change. Assumed."""

FORM_ALIKE: Final = 0.8
"""Correlation of that error between neighbouring levels. Assumed."""

IMAGE_ERROR: Final = 0.15
"""The same in an image, where edges lie elsewhere. Assumed."""

IMAGE_WIDE_MM: Final = 4.0
"""Width of that error in an image. Assumed: about a part of a map."""

IMAGE_ALIKE: Final = 0.97
"""Correlation of that error between neighbouring levels. Assumed."""

# ------------------------------------------------ adaptation: a name, and is the gap closed?

LEFT: Final = ALPHA
"""p of what the only explanation leaves, below which it is not named: a name leaves nothing that would be
detected, or what one effect more explains, which is reported beside it."""

NAMED: Final = 0.02
"""Adjusted p of an effect's own evidence, from which on it is not named though nothing else fits: ALPHA lets
one limb in twenty with nothing missing come as far. Chosen, after 0.043 had given a limb a wrong name."""

NAMED_BY_GAIN: Final = 1000.0
"""Times that the p of a refit's gain is taken there: it counts on errors being normal and known, and a
model's are not. Chosen, after 10 had given a limb drawn by seed, with nothing hidden, a name (a gain of 22
where the first order had 12)."""

CLOSED_PERCENTILE: Final = 95.0
"""Per cent of placebos (smooth curves of no meaning, each the best of as many as there are candidates) that a
named effect must beat. Convention."""

CLOSED_BY_SEVERAL_PERCENTILE: Final = 99.0
"""The same of several effects, whose placebos are picked from as many combinations. Chosen."""

MOST_NAMED: Final = 2
"""Effects in a name: three bend to almost any smooth gap. Chosen."""

MOST_PICKED: Final = 100
"""Combinations that a placebo is picked from at most. Chosen, for time."""

N_PLACEBOS: Final = 1000
"""Placebos: at the 95th percentile a deviation of 0.7. Chosen, for time."""

TOO_WIDE: Final = 1.0
"""Deviation of a prediction over that of its reading, beyond which a held-out block tests nothing: what such
a prediction is off by is mostly that the rest does not determine the parameters. Chosen."""

# ------------------------------------------------ what is reported

WITHIN: Final = 3.84
"""Deviance above the best within which a parameter's value lies in its interval: 95 %, one parameter.
Convention (chi2 with one degree of freedom)."""

MAP_DOUBT: Final = 1.35
"""Times which the intervals of c and m (in ln) and of effects' sizes are widened where maps determine them:
the model's error in maps is taken at its likeliest, and by so much the errors of c and m exceeded the
reported ones, root mean square, at sites that another solver made
(`tests/benchmarks/figures/diagnosis-febio.md`). Chosen."""

SIZE_WITHIN: Final = 1.96
"""Deviations of the interval of an effect's size: 95 %. Convention (normal law)."""

PULLED: Final = 0.1
"""Change of ln m from which the prior counts as having moved m. Chosen."""

POWER: Final = 0.8
"""Power at which an effect's size counts as detectable. Convention."""

BIAS_MATTERS_SD: Final = 1.0
"""Shift of c or m by an unseen effect, in their own deviations, from which it is reported. Chosen."""

NEXT_SIGNIFICANT: Final = 0.95
"""1 - level of the one-sided test between two explanations after the next measurement. Convention."""

NEXT_POWER: Final = 0.5
"""Power from which a next measurement is proposed. Chosen."""

# ------------------------------------------------ uncertainty of the simulation and of the readings

MATTERS_SD: Final = 0.3
"""Deviations that a change of mesh, cut, contact or compressibility may move the data before the report says
that it matters. Chosen."""

DOUBTFUL: Final = 0.15
"""ln force by which such an uncertainty, as it enters the noise, makes a verdict uncertain. Chosen."""

ON_BOUND: Final = 1e-3
"""Share of a parameter's range within which it stands on its bound. Numerical."""

FALLEN_SD: Final = 4.0
"""Deviations by which forces must fall over all holds before holds count as recorded relaxation, where the
depth was not recorded. Chosen."""

RAMP_SD: Final = 5.0
"""Deviations of its own noise that a slope must have to be a ramp. Chosen."""

DEPTH_OUTLIER_SD: Final = 4.0
"""Deviations of the depth's reading; what is further off is no error of reading. Chosen."""
