"""Result types of a diagnosis: the verdict and all results that support it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from limbcli.diagnostics.conclusions.blind_spots import BlindSpot
from limbcli.diagnostics.conclusions.effect_sizes import RefittedSizes
from limbcli.diagnostics.conclusions.next_measurement import NextStep
from limbcli.diagnostics.model.common_errors import CommonError
from limbcli.diagnostics.model.estimates import Reported
from limbcli.diagnostics.model.forward_model import Explanation, Facts, Fitted
from limbcli.diagnostics.selection.confidence_set import Refit
from limbcli.diagnostics.statistical_tests.multiple_testing import Family
from limbcli.diagnostics.statistical_tests.roughness import Roughness

Word = Literal["adequate", "named", "ambiguous", "unexplained", "untestable"]


@dataclass(frozen=True, eq=False)
class Shrink:
    """Goodness of fit at one stage of the model, from the base to the full explanation.

    rms : by channel, of residual / standard deviation; placebo_percentile : of the chi2 explained by the
    effects added so far; held_out : by block, and "all" over the blocks that every stage predicts
    estimates : parameters with their intervals; chi2, rms and held_out are those of the best fit
    """

    explanation: Explanation
    chi2: float
    nu: int
    rms: Mapping[str, float]
    held_out: Mapping[str, float]
    estimates: Reported
    placebo_percentile: float | None = None

    @property
    def chi2_per_nu(self) -> float:
        return self.chi2 / max(self.nu, 1)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict and the results it is based on.

    relative : the noise level is unknown (assumed, or contradicted by the scatter)
    chosen : the explanation added to the model (empty if none)
    confidence_set : explanations that these data cannot distinguish
    closed : the gap is closed (an effect is named): no significant residual remains, the explanation exceeds
    the placebos, and the held-out error fell
    not_evaluated : candidate -> reason
    left_out : refit that was dropped -> reason
    sizes : by effect and parameter, the 95 % interval of its distance from null when it alone is added, to
    first order; refitted_sizes : by effect that was refitted alone, the intervals of the parameters' values
    angles : cosines between the changes in the data by each pair of members of the confidence set
    common_errors : by fitted explanation, what its fit makes of the unknowns that many data have in common
    """

    verdict: Word
    reason: str
    relative: bool
    base: Fitted
    family: Family
    flagged: tuple[str, ...]
    refits: tuple[Refit, ...]
    confidence_set: tuple[Explanation, ...]
    chosen: Explanation
    closed: bool
    shrink: tuple[Shrink, ...]
    blind_spots: tuple[BlindSpot, ...]
    next_steps: tuple[NextStep, ...]
    angles: Mapping[str, float] = field(default_factory=dict)
    not_evaluated: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    roughness: Roughness | None = None
    facts: Mapping[str, Facts] = field(default_factory=dict)
    seed: int = 0
    held_out_z: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sizes: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)
    refitted_sizes: Mapping[str, RefittedSizes] = field(default_factory=dict)
    common_errors: Mapping[Explanation, tuple[CommonError, ...]] = field(default_factory=dict)

    @property
    def estimates(self) -> Reported:
        """Parameters of the final model, including the chosen effects if there are any."""
        return next(
            (s.estimates for s in self.shrink if s.explanation == self.chosen), self.shrink[0].estimates
        )

    @property
    def final(self) -> Fitted:
        for refit in self.refits:
            if refit.explanation == self.chosen:
                return refit.fitted
        return self.base
