"""What every step of a diagnosis stands on: the data, the fit without effects, and how tests are made."""

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
    """The fit without effects, and what is left by it. `seed` fixes every draw."""

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
        """The data's own scatter, level by level; None where it cannot be determined."""
        return self._roughness(self.state)

    @cached_property
    def relative(self) -> bool:
        """The noise's level is not known: assumed, or contradicted by the scatter about the base fit."""
        return self.is_relative(self.state)

    def is_relative(self, state: LinearFit) -> bool:
        """The same about another fit: what scattered may have been an effect (a step, a jump) in it."""
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
        """What all families are drawn from."""
        return ErrorDraws((self.seed, 1), len(self.data), self.n_draws)

    def family(
        self, state: LinearFit, trials: Sequence[Trial], *, relative: bool,
        decisive: Sequence[float] = (thresholds.ALPHA, thresholds.NAMED),
    ) -> Family:  # fmt: skip
        """All these tests with one false-alarm rate; `decisive`: adjusted p by which something is decided."""
        return score_family(
            state, trials, self.errors, relative=relative, alpha=thresholds.ALPHA, decisive=decisive
        )

    def form_error(self, fitted: Fitted) -> Array:
        """Covariance (n, n) of the error in an effect's form: a share of what the effects change in this
        tissue, alike at neighbouring levels. Fibres, skin or fat in a limb are never just the model's."""
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
        """Covariance (n, n) of errors of this size in one channel's images."""
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
