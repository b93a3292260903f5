"""Comparison of the limb as segmented with one with changed bones, each with the effects found on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from limbcli.diagnostics.conclusions.verdict import Diagnosis
from limbcli.diagnostics.model.estimates import Reported
from limbcli.diagnostics.model.forward_model import Explanation
from limbcli.stages.diagnosis.bones.evidence import Evidence

_BONES_OR_EFFECT = "one effect explains the data, and so does the limb with other bones (see `bones`)"
_ON_MENDED_LIMB = (
    "one explanation fits, but with a limb whose bones had to be moved (see `bones`): correct the "
    "segmentation "
    "first"
)

Outcome = Literal["as segmented", "other bones", "either"]


def may_be_elsewhere(ours: Diagnosis) -> bool:
    """Whether other bones could still change the verdict, as the limb as segmented leaves a residual."""
    return ours.verdict not in ("adequate", "untestable")


def weighed(
    ours: Diagnosis, theirs: Diagnosis, *, gain: float, required: float, is_repair: bool = False
) -> Outcome:
    """Select the limb that needs fewer effects and fits better; "either" if these criteria disagree.

    theirs : the diagnosis on the limb with other bones; gain : reduction of deviance by its best explanation
    compared with ours; required : smallest gain or loss that counts; is_repair : the segmented bones are
    known to be wrong, so that changing them is no further assumption; otherwise the change counts as one
    effect
    """
    here, there = _size(ours), _size(theirs) + (not is_repair)
    simpler = (here > there) - (here < there)
    better = (gain >= required) - (gain <= -required)
    for_them = simpler + better
    return "either" if not for_them else "other bones" if for_them > 0 else "as segmented"


def _size(found: Diagnosis) -> float:
    """The smallest number of effects that explains the data; infinite if none do."""
    return float(min((len(each) for each in fitting(found)), default=float("inf")))


def fitting(found: Diagnosis) -> tuple[Explanation, ...]:
    """Explanations that fit the data on that limb; the empty explanation if nothing is missing."""
    if found.verdict in ("adequate", "untestable"):
        return ((),)
    return () if found.verdict == "unexplained" else found.confidence_set


def combined_diagnosis(ours: Diagnosis, theirs: Diagnosis, words: str) -> Diagnosis:
    """Our diagnosis extended by the explanations that fit on the other limb; intervals of c and m cover both.

    words : description of the other limb
    """
    if not fitting(theirs):
        return ours
    if not fitting(ours):
        return replace(ours, reason=f"{ours.reason}; with the limb {words} an explanation fits (see `bones`)")
    both = _union(ours.confidence_set, theirs.confidence_set)
    reason = (
        f"what fits with the limb as segmented and what fits with the limb {words} cannot be distinguished"
    )
    estimates = _over(ours, theirs)
    shrink = tuple(
        replace(each, estimates=estimates) if each.explanation == ours.chosen else each
        for each in ours.shrink
    )
    return replace(ours, verdict="ambiguous", closed=False, reason=reason, confidence_set=both, shrink=shrink)


def with_bone_warnings(found: Diagnosis, bones: Sequence[Evidence]) -> Diagnosis:
    """Change "named" to "ambiguous" where the position of the bones is in question.

    This is so if a limb with other bones fits as well, or if bones were moved: their true position is known
    to within some mm only, and such an error resembles other effects.
    """
    if found.verdict != "named":
        return found
    if any(each.stand == "open" for each in bones):
        return replace(found, verdict="ambiguous", closed=False, reason=_BONES_OR_EFFECT)
    if any(each.stand == "taken" and each.other.is_repair for each in bones):
        return replace(found, verdict="ambiguous", closed=False, reason=_ON_MENDED_LIMB)
    return found


def _union(ours: Sequence[Explanation], theirs: Sequence[Explanation]) -> tuple[Explanation, ...]:
    """Union of both sets, ignoring the order of effects."""
    known = {frozenset(each) for each in ours}
    return (*ours, *(each for each in theirs if frozenset(each) not in known))


def _over(ours: Diagnosis, theirs: Diagnosis) -> Reported:
    """Our estimates, with intervals extended to cover theirs."""
    estimates = ours.estimates.whichever([theirs.estimates])
    return replace(estimates, over=len(ours.confidence_set) + len(fitting(theirs)))
