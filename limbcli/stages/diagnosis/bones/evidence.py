"""Evidence of the readings for a limb with other bones: likelihoods of the fits on both limbs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2 as chi2_distribution

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.conclusions.verdict import Diagnosis
from limbcli.diagnostics.model.forward_model import Fitted
from limbcli.model import Array, IntArray
from limbcli.stages.diagnosis.bones.bone_hypotheses import OtherBones
from limbcli.stages.diagnosis.forward_model.site_forward_model import SiteForwardModel

Stand = Literal["taken", "open", "not taken"]


@dataclass(frozen=True)
class Evidence:
    """Evidence for a limb with other bones.

    gain : reduction of the deviance, -2 ln likelihood, over the `n` readings that both limbs predict
    fits : whether the limb with the other bones leaves no significant residual
    stand : the outcome, "open" if an effect on the limb as segmented explains as much
    with_effects : the diagnosis on that limb, if any
    """

    other: OtherBones
    gain: float
    n: int
    fits: bool
    stand: Stand = "not taken"
    with_effects: Diagnosis | None = None

    @property
    def required_gain(self) -> float:
        """Gain required for acceptance, with an allowance for the effect of remeshing."""
        return self.other.needed + thresholds.BONES_REMESHED * self.n

    @property
    def speaks_for_it(self) -> bool:
        return self.gain >= self.required_gain

    @property
    def is_decisive(self) -> bool:
        """Whether it is accepted without testing effects: no residual is left, and the gain is very large."""
        return self.speaks_for_it and self.fits and self.gain >= thresholds.BONES_DECISIVE

    def beats(self, effect_gain: float) -> bool:
        """Whether it is preferred to an effect on the limb as segmented with this gain."""
        return self.gain - effect_gain >= self.required_gain

    def against(self, effect_gain: float) -> Evidence:
        """The outcome against an effect that it does not beat: open, unless the effect beats it."""
        beaten = effect_gain - self.gain >= self.required_gain
        return replace(self, stand="not taken" if beaten else "open")

    @property
    def sentence(self) -> str:
        """Sentence for the report: what was tried, and the outcome."""
        words = self.other.words
        if self.stand == "taken":
            return (
                f"BONES: {words} the limb fits the readings better (deviance lower by {self.gain:.0f}, "
                f"{self.required_gain:.0f} required): the surfaces are not accepted there, and "
                "all that follows refers to the changed limb. Correct the segmentation."
            )
        if self.stand == "open":
            return (
                f"BONES: {words} the limb also fits the readings better (deviance lower by {self.gain:.0f}): "
                "these data do not show whether this or an effect on the limb as segmented is the cause. "
                f"{self._there}Check the segmentation first."
            )
        if self.other.is_repair:
            return f"Tried {words}: deviance {-self.gain:+.0f}; the limb is taken as segmented."
        return ""

    @property
    def _there(self) -> str:
        """Sentence on the explanations that fit on that limb."""
        if self.with_effects is None:
            return ""
        effects = "; ".join(" + ".join(each) for each in self.with_effects.confidence_set)
        if self.with_effects.verdict == "adequate":
            return "With that limb nothing else is missing. "
        return (
            f"With that limb it may be: {effects}. "
            if effects
            else "With that limb nothing explains the rest. "
        )

    def to_json(self) -> dict[str, object]:
        return {
            "words": self.other.words, "left_out": list(self.other.left_out),
            "moved_mm": {name: list(move) for name, move in self.other.moved.items()},
            "deviance_gain": self.gain, "gain_required": self.required_gain, "n_readings": self.n,
            "taken": self.stand == "taken", "open": self.stand == "open",
            "with_effects": None if self.with_effects is None else _summary(self.with_effects),
        }  # fmt: skip


def _summary(found: Diagnosis) -> dict[str, object]:
    """Summary of a diagnosis on another limb."""
    estimates = found.estimates
    return {
        "verdict": found.verdict, "confidence_set": [list(each) for each in found.confidence_set],
        "values": dict(estimates.values),
        "intervals_95": {name: list(ends) for name, ends in estimates.intervals.items()},
    }  # fmt: skip


def is_poor_fit(model: SiteForwardModel, fitted: Fitted, level: float) -> bool:
    """Whether the chi2 of a fit has a p below this level."""
    everything = np.arange(len(model.data))
    off = _deviance(model, fitted, everything, with_size=False)
    freedom = max(len(everything) - fitted.jacobian.shape[1], 1)
    return bool(chi2_distribution.sf(off, freedom) < level)


def compared(
    other: OtherBones, ours: SiteForwardModel, our_fit: Fitted, theirs: SiteForwardModel, their_fit: Fitted
) -> Evidence:
    """Compare fits on the limb as segmented (`ours`) and on the limb with other bones (`theirs`)."""
    here, there = _rows_in_both(ours, theirs)
    gain = _deviance(ours, our_fit, here) - _deviance(theirs, their_fit, there)
    fits = not is_poor_fit(theirs, their_fit, thresholds.ALPHA)
    return Evidence(other, float(gain), len(here), fits)


def _rows_in_both(ours: SiteForwardModel, theirs: SiteForwardModel) -> tuple[IntArray, IntArray]:
    """Indices (n,) of the common readings in each model's data, which differ as bones hide parts of maps."""
    first, second = _keys(ours), _keys(theirs)
    there = {key: k for k, key in enumerate(second)}
    pairs = [(k, there[key]) for k, key in enumerate(first) if key in there]
    found = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _keys(model: SiteForwardModel) -> list[tuple[int, str, int, int]]:
    return [
        (number, row.channel, row.level, row.part)
        for number, each in enumerate(model.sites)
        for row in each.site.rows
    ]


def _deviance(model: SiteForwardModel, fitted: Fitted, rows: IntArray, *, with_size: bool = True) -> float:
    """-2 ln likelihood of these readings up to a constant; chi2 alone if not `with_size`."""
    off: Array = (model.data.y - fitted.prediction)[rows]
    factor = cho_factor(model.data.noise.covariance[np.ix_(rows, rows)], lower=True)
    chi2 = float(off @ cho_solve(factor, off))
    return chi2 + (2.0 * float(np.log(np.diag(factor[0])).sum()) if with_size else 0.0)
