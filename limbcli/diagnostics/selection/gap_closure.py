"""Test for a closed gap: does the model outperform arbitrary smooth curves and predict held-out data?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.selection.baseline_fit import BaselineFit
from limbcli.diagnostics.selection.confidence_set import Refit
from limbcli.diagnostics.statistical_tests.heldout import fell, held_out_error
from limbcli.diagnostics.statistical_tests.placebo import library_percentile, placebo_percentile


@dataclass(frozen=True, eq=False)
class Closing:
    """n_candidates : number of candidates from which an explanation was selected"""

    baseline: BaselineFit
    n_candidates: int

    def is_closed(self, refit: Refit) -> bool:
        data = self.baseline.data
        before, after = held_out_error(data, self.baseline.base), held_out_error(data, refit.fitted)
        n_effects = len(refit.explanation)
        if n_effects > thresholds.MOST_NAMED:  # three effects can fit almost any smooth residual
            return False
        if not fell(before, after, data.blocks) or self.percentile(refit) <= thresholds.CLOSED_PERCENTILE:
            return False
        required = thresholds.CLOSED_PERCENTILE if n_effects == 1 else thresholds.CLOSED_BY_SEVERAL_PERCENTILE
        return self._library_percentile(refit) > required

    def percentile(self, refit: Refit) -> float:
        """Percentage of placebos, each of as many smooth directions as were added, that explain less."""
        baseline = self.baseline
        return placebo_percentile(
            baseline.state, baseline.whiten, self._explained(refit), n_parameters=self._added(refit),
            channels=baseline.data.channels(), order=baseline.data.order, deviation=baseline.data.deviation,
            rng=baseline.rng(3),
        )  # fmt: skip

    def _library_percentile(self, refit: Refit) -> float:
        """The same with each placebo selected from as many combinations as the explanation was."""
        baseline = self.baseline
        n_tried = min(math.comb(self.n_candidates, len(refit.explanation)), thresholds.MOST_PICKED)
        return library_percentile(
            baseline.state, baseline.whiten, self._explained(refit), n_parameters=self._added(refit),
            n_tried=n_tried, channels=baseline.data.channels(), order=baseline.data.order,
            deviation=baseline.data.deviation, rng=baseline.rng(4),
        )  # fmt: skip

    def _explained(self, refit: Refit) -> float:
        return self.baseline.state.chi2 - refit.state.chi2

    def _added(self, refit: Refit) -> int:
        """Number of effect parameters that affect the prediction."""
        columns = refit.fitted.jacobian[:, len(refit.fitted.base_names) :]
        return max(int(np.any(columns != 0.0, axis=0).sum()), 1)
