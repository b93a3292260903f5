"""Results reported with the verdict: reduction of the residual, undetectable effects, next measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.diagnostics.conclusions.blind_spots import BlindSpot, blind_spot
from limbcli.diagnostics.conclusions.effect_sizes import RefittedSizes, refitted_sizes, sizes_95
from limbcli.diagnostics.conclusions.next_measurement import NextStep, rank_proposals
from limbcli.diagnostics.conclusions.verdict import Shrink
from limbcli.diagnostics.model.common_errors import CommonError, common_errors
from limbcli.diagnostics.model.estimates import Reported
from limbcli.diagnostics.model.forward_model import Explanation, Facts, Fitted
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.selection.baseline_fit import BaselineFit
from limbcli.diagnostics.selection.confidence_set import Refit
from limbcli.diagnostics.selection.gap_closure import Closing
from limbcli.diagnostics.selection.refits import Refits
from limbcli.diagnostics.statistical_tests.heldout import (
    determined_by_the_rest,
    held_out_error,
    over_shared,
)
from limbcli.diagnostics.statistical_tests.localisation_tests import predicted_without
from limbcli.diagnostics.statistical_tests.multiple_testing import Family
from limbcli.diagnostics.statistical_tests.score import Trial
from limbcli.errors import LimbError
from limbcli.interval_limits import THRESHOLD_95, noise_scale, threshold_95

_MOST_COMPARED = 5  # largest number of members compared in choosing the next measurement


@dataclass(frozen=True, eq=False)
class Account:
    """Computes the results that are reported with the verdict."""

    baseline: BaselineFit

    def shrink(
        self, refit: Refit | None, refits: Refits | None, alike: Sequence[Refit] = ()
    ) -> tuple[Shrink, ...]:
        """Stages from the base model to the full explanation, with its effects added one at a time.

        alike : explanations that the data cannot exclude; the last stage's intervals of c and m cover theirs
        """
        baseline = self.baseline
        stages = [self._stage(baseline.base, baseline.state, None)]
        if refit is None or refits is None:
            return tuple(stages)
        closing = Closing(baseline, len(refits.trials))
        for size in range(1, len(refit.explanation)):
            part = refits.of(refit.explanation[:size])
            if part is not None:
                stages.append(self._stage(part.fitted, part.state, closing.percentile(part)))
        last = self._stage(refit.fitted, refit.state, closing.percentile(refit))
        others = [
            self.estimates(each.fitted, each.state)
            for each in alike if each.explanation != refit.explanation
        ]  # fmt: skip
        if others:
            last = replace(last, estimates=last.estimates.whichever(others))
        stages.append(last)
        held_out = over_shared([each.held_out for each in stages], baseline.data.blocks)
        return tuple(replace(each, held_out=held) for each, held in zip(stages, held_out, strict=True))

    def _stage(self, fitted: Fitted, state: LinearFit, percentile: float | None) -> Shrink:
        data = self.baseline.data
        z = (data.y - fitted.prediction) / data.deviation
        rms = {name: float(np.sqrt(np.mean(z[mask] ** 2))) for name, mask in data.channels().items()}
        estimates = self.estimates(fitted, state)
        return Shrink(
            fitted.explanation, state.chi2, state.nu, rms, held_out_error(data, fitted), estimates, percentile
        )

    def estimates(self, fitted: Fitted, state: LinearFit) -> Reported:
        """Parameter values and intervals to report for a fit."""
        return self.baseline.forward_model.reported(
            fitted, scale=self._scale_within(state), besides=self.baseline.form_error(fitted)
        )

    def refitted_sizes(self, refits: Refits, shrink: Sequence[Shrink]) -> dict[str, RefittedSizes]:
        """Sizes of every effect that was refitted alone, or can be without a simulation, and stayed within
        its bounds.

        The first-order interval at the fit without effects is far too narrow where an effect that hardly
        shows has moved c and m far, such as a preload in a record of forces.

        Where `shrink` has a stage for the effect, the interval also covers that stage's, whose profile over m
        captures nonlinearity that the sensitivities do not.
        """
        found, whiten, widening = {}, self.baseline.whiten, self.baseline.forward_model.interval_widening
        for name in refits.trials:
            fitted = refits.alone(name)
            if fitted is None or fitted.at_bound:
                continue
            form = whiten(whiten(self.baseline.form_error(fitted)).T)
            scale = self._scale_within(self.baseline.linearised(fitted))
            sizes = refitted_sizes(fitted, whiten(fitted.jacobian), scale, form, widening)
            found_by = (stage.estimates for stage in shrink if stage.explanation == (name,))
            reported = next(found_by, None)
            found[name] = sizes if reported is None else sizes.hull_with(reported.intervals)
        return found

    def sizes_95(
        self, family: Family, facts: Mapping[str, Facts], trials: Mapping[str, Trial]
    ) -> dict[str, dict[str, tuple[float, float]]]:
        """Size intervals (95 %) of every candidate, to first order at the fit without effects."""
        state, widening = self.baseline.state, self.baseline.forward_model.interval_widening
        return sizes_95(state, family, facts, trials, self._scale(state), widening)

    def _scale(self, state: LinearFit) -> float:
        return noise_scale(state.chi2, state.nu) if self.baseline.is_relative(state) else 1.0

    def _scale_within(self, state: LinearFit) -> float:
        """The same for intervals about a fit, which are wider where few data determine the noise level."""
        if not self.baseline.is_relative(state):
            return 1.0
        return self._scale(state) * threshold_95(state.chi2, state.nu) / THRESHOLD_95

    def blind_spots(self, family: Family, facts: Mapping[str, Facts]) -> tuple[BlindSpot, ...]:
        """Detectability of every candidate at its typical size, the least detectable first."""
        spots = []
        for tested in family.tests:
            known = facts.get(tested.name)
            direction = tested.score.direction
            if known is None or not known.typical or not direction.names:
                continue
            typical = np.array([known.typical.get(name, 0.0) for name in direction.names])
            spots.append(
                blind_spot(self.baseline.state, tested.name, direction, typical, critical=tested.critical,
                           base_names=self.baseline.base.base_names, scale=self._scale(self.baseline.state))
            )  # fmt: skip
        return tuple(sorted(spots, key=lambda spot: -spot.detectable_times_typical))

    def common_errors(self, refits: Sequence[Refit]) -> dict[Explanation, tuple[CommonError, ...]]:
        """Estimates of the unknowns that many data have in common, by explanation; () is the base model."""
        baseline = self.baseline
        states = {(): baseline.state} | {each.explanation: each.state for each in refits}
        return {
            explanation: common_errors(baseline.data.noise, baseline.whiten, state)
            for explanation, state in states.items()
        }

    def next_steps(self, kept: Sequence[Refit], not_evaluated: dict[str, str]) -> tuple[NextStep, ...]:
        """Measurements that would distinguish the members of the set.

        Where the noise level is unknown, the existing data are weighted by their scatter about the best
        member.
        """
        if len(kept) < 2:
            return ()
        best, *_ = members = sorted(kept, key=lambda refit: refit.state.chi2)[:_MOST_COMPARED]
        fits = [refit.fitted for refit in members]
        try:
            proposals = self.baseline.forward_model.proposals(fits)
        except LimbError as error:
            not_evaluated["next measurement"] = error.what
            return ()
        whiten = Whitener(np.sqrt(self._scale(best.state)) * self.baseline.whiten.factor)
        return tuple(rank_proposals(fits, proposals, whiten))

    def angles(self, kept: Sequence[Refit]) -> dict[str, float]:
        """Cosines between the changes in the data by members of the set, without what refitting removes."""
        baseline = self.baseline
        found = {}
        changes = []
        for refit in kept:
            change = baseline.whiten(refit.fitted.prediction - baseline.base.prediction)
            changes.append((" + ".join(refit.explanation), baseline.state.project(change)))
        for i, (a, x) in enumerate(changes):
            for b, y in changes[i + 1 :]:
                size = float(np.linalg.norm(x) * np.linalg.norm(y))
                found[f"{a} / {b}"] = float(x @ y) / size if size > 0 else 0.0
        return found

    def held_out_z(self) -> dict[str, tuple[float, float]]:
        """(root mean square, largest |z|) of each part of the data, predicted from the other data."""
        data, base = self.baseline.data, self.baseline.base
        residual = data.y - base.prediction
        return {
            name: predicted_without(residual, base.jacobian, data.noise.covariance, mask)
            for name, mask in determined_by_the_rest(data.groups, base.jacobian).items()
        }
