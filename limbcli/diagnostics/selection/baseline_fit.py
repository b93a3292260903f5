"""Common basis of all steps of a diagnosis: the data, the fit without effects, and the test settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Data, Fitted, ForwardModel
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.model.noise import ErrorDraws, correlated
from limbcli.diagnostics.statistical_tests.localisation_tests import group_trials
from limbcli.diagnostics.statistical_tests.multiple_testing import Family, score_family
from limbcli.diagnostics.statistical_tests.roughness import Roughness, roughness
from limbcli.diagnostics.statistical_tests.score import Trial
from limbcli.model import Array
from limbcli.progress import SILENT, Progress


@dataclass(frozen=True, eq=False)
class BaselineFit:
    """The fit without effects and its residual. `seed` determines all random draws."""

    forward_model: ForwardModel
    base: Fitted
    seed: int
    n_draws: int
    progress: Progress = SILENT

    @property
    def data(self) -> Data:
        return self.forward_model.data

    @cached_property
    def whiten(self) -> Whitener:
        return Whitener.of(self.data.noise.covariance)

    @cached_property
    def state(self) -> LinearFit:
        return self.linearised(self.base)

    @cached_property
    def rough(self) -> Roughness | None:
        """Scatter of the data about smooth curves over the levels; None where it cannot be determined."""
        return self._roughness(self.state)

    @cached_property
    def relative(self) -> bool:
        """Whether the noise level is unknown: assumed, or contradicted by the scatter about the base fit."""
        return self.is_relative(self.state)

    def is_relative(self, state: LinearFit) -> bool:
        """The same for another fit, which may explain apparent scatter as an effect (a step or jump)."""
        if state.nu < 1:
            return False
        found = self._roughness(state)
        return self.data.noise.is_assumed or (found is not None and found.p < thresholds.ROUGH_P)

    def _roughness(self, state: LinearFit) -> Roughness | None:
        if state.nu < 1:
            return None
        return roughness(state, self.whiten, series=self.data.all_series(), order=self.data.order)

    def rng(self, stream: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, stream])

    def linearised(self, fitted: Fitted) -> LinearFit:
        off, jacobian = self.whiten(self.data.y - fitted.prediction), self.whiten(fitted.jacobian)
        return LinearFit.of(off, jacobian, as_it_stands=True)

    @cached_property
    def errors(self) -> ErrorDraws:
        """The common error draws of all families of tests."""
        return ErrorDraws((self.seed, 1), len(self.data), self.n_draws)

    def family(
        self, state: LinearFit, trials: Sequence[Trial], *, relative: bool,
        decisive: Sequence[float] = (thresholds.ALPHA, thresholds.NAMED),
    ) -> Family:  # fmt: skip
        """All these tests at one family-wise error rate; `decisive`: decision levels of the adjusted p."""
        return score_family(
            state, trials, self.errors, relative=relative, alpha=thresholds.ALPHA, decisive=decisive
        )

    def form_error(self, fitted: Fitted) -> Array:
        """Covariance (n, n) of the model-form error: a fraction of the change by the effects in this tissue,
        correlated between neighbouring levels. Fibres, skin or fat in a limb never match the model
        exactly."""
        data = self.data
        total = np.zeros((len(data), len(data)))
        if fitted.without is None:
            return total
        change = thresholds.FORM_ERROR * np.abs(fitted.prediction - fitted.without)
        imaged = np.zeros(len(data), dtype=bool)
        if data.place is not None:
            imaged = np.asarray(np.isfinite(data.place).all(axis=1))
        for mask in data.channels().values():
            if np.all(imaged[mask]):
                total += self._in_image(
                    np.where(mask, change / thresholds.FORM_ERROR * thresholds.IMAGE_ERROR, 0.0)
                )
                continue
            part = correlated("form", np.where(mask, change, 0.0), data.order,
                              correlation=thresholds.FORM_ALIKE, source="computed")  # fmt: skip
            total += part.covariance
        return total

    def _in_image(self, size: Array) -> Array:
        """Covariance (n, n) of errors with this standard deviation (n,) in one channel's images."""
        data = self.data
        assert data.place is not None
        x, z = np.nan_to_num(data.place).T
        apart = np.hypot(np.subtract.outer(x, x), np.subtract.outer(z, z))
        near = np.exp(-0.5 * (apart / thresholds.IMAGE_WIDE_MM) ** 2)
        alike = thresholds.IMAGE_ALIKE ** np.abs(np.subtract.outer(data.order, data.order))
        return np.asarray(near * alike * np.outer(size, size))

    def parts(self, whiten: Whitener) -> list[Trial]:
        """One trial for each part of the data."""
        return group_trials(whiten, self.data)
