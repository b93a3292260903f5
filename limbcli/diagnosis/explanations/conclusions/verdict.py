"""Result types of a diagnosis: the verdict and all results that support it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from limbcli.diagnosis.explanations.conclusions.blind_spots import BlindSpot
from limbcli.diagnosis.explanations.conclusions.estimates import Estimates
from limbcli.diagnosis.explanations.conclusions.next_measurement import NextStep
from limbcli.diagnosis.explanations.model.forward_model import Explanation, Facts, Fitted
from limbcli.diagnosis.explanations.model.noise_covariance import CommonError
from limbcli.diagnosis.explanations.predictive_check import Check
from limbcli.diagnosis.explanations.probabilities import Explained
from limbcli.diagnosis.explanations.residuals import Roughness

Word = Literal["adequate", "named", "ambiguous", "unexplained", "untestable"]


@dataclass(frozen=True, eq=False)
class Shrink:
    """Goodness of fit at one stage of the model, from the base to the full explanation.

    rms : by channel, of residual / standard deviation; held_out : by block, and "all" over the blocks that
    every stage predicts; estimates : parameters with their intervals; chi2, rms and held_out are those of the
    best fit
    """

    explanation: Explanation
    chi2: float
    nu: int
    rms: Mapping[str, float]
    held_out: Mapping[str, float]
    estimates: Estimates

    @property
    def chi2_per_nu(self) -> float:
        return self.chi2 / max(self.nu, 1)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict and the results it is based on.

    relative : the noise level is unknown (assumed, or contradicted by the scatter)
    nothing, adequate_from : probability that nothing is missing, against all single effects, and the value
    that 95 % of the measurements with nothing missing exceed
    explanations : all, the most probable first; confidence_set : those that together have 95 %
    effects : probability of each effect, over all explanations
    chosen : the explanation added to the model (empty if none)
    check, left : of the fit without effects, and of the most probable explanation
    not_evaluated : candidate -> reason
    sizes : by effect and parameter, the 95 % interval of its value when it alone is added
    common_errors : by fitted explanation, what its fit makes of the unknowns that many data have in common
    """

    verdict: Word
    reason: str
    relative: bool
    base: Fitted
    nothing: float
    adequate_from: float
    explanations: tuple[Explained, ...]
    confidence_set: tuple[Explanation, ...]
    effects: Mapping[str, float]
    chosen: Explanation
    check: Check | None
    left: Check | None
    shrink: tuple[Shrink, ...]
    blind_spots: tuple[BlindSpot, ...] = ()
    next_steps: tuple[NextStep, ...] = ()
    not_evaluated: Mapping[str, str] = field(default_factory=dict)
    roughness: Roughness | None = None
    facts: Mapping[str, Facts] = field(default_factory=dict)
    seed: int = 0
    sizes: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)
    common_errors: Mapping[Explanation, tuple[CommonError, ...]] = field(default_factory=dict)

    @property
    def flagged(self) -> tuple[str, ...]:
        """Parts of the data that the fit without effects does not describe."""
        return () if self.check is None else self.check.flagged

    @property
    def estimates(self) -> Estimates:
        """Parameters of the final model, including the chosen effects if there are any."""
        return self.shrink[-1].estimates

    @property
    def fits(self) -> dict[Explanation, Fitted]:
        """The fits of the explanations that were fitted."""
        return {each.explanation: each.posterior.fitted for each in self.explanations if each.posterior}

    @property
    def final(self) -> Fitted:
        """The fit of the chosen explanation."""
        return self.fits.get(self.chosen, self.base)
