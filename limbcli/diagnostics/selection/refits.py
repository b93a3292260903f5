"""Refits of explanations: first on the forward model's surrogate, then simulated if near the best."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Direction, Explanation, Facts, Fitted
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.selection.baseline_fit import BaselineFit
from limbcli.diagnostics.selection.confidence_set import Refit, compare, joint_trial
from limbcli.diagnostics.selection.form_error import form_allowances
from limbcli.diagnostics.statistical_tests.score import Trial, narrowed, score
from limbcli.errors import LimbError


@dataclass(eq=False)
class Refits:
    """All refits of a diagnosis so far. Failed refits are recorded in `not_evaluated` and dropped ones in
    `left_out`, each with its reason."""

    baseline: BaselineFit
    trials: dict[str, Trial]
    facts: Mapping[str, Facts]
    not_evaluated: dict[str, str]
    left_out: dict[str, str]
    known: dict[Explanation, Refit] = field(default_factory=dict)
    _few: dict[str, Trial] = field(default_factory=dict)

    def compared(self, several: Sequence[Explanation]) -> list[Refit]:
        """Refits of these explanations, each with its deviance gap to the best and the allowed gap."""
        baseline, several = self.baseline, [self._in_order(each) for each in several]
        joint: dict[Explanation, Trial] = {(name,): trial for name, trial in self.trials.items()}
        joint |= {each: self._joint(each) for each in several}
        found = self._refitted(several)
        relative = all(baseline.is_relative(each.state) for each in found)
        refits = compare(
            found, baseline.base, baseline.state, joint, baseline.whiten, baseline.form_error,
            rng=baseline.rng(2), relative=relative,
        )  # fmt: skip
        self.known.update({each.explanation: each for each in refits})
        return refits

    def of(self, explanation: Explanation) -> Refit | None:
        """One refit, made on demand; None if it failed."""
        explanation = self._in_order(explanation)
        if explanation not in self.known:
            fitted = self._draft(explanation)
            if fitted is not None:
                best = self.best()
                limit = math.inf if best is None else best.state.chi2 + thresholds.HOPELESS
                self._settle(explanation, fitted, simulated=self.baseline.linearised(fitted).chi2 <= limit)
        return self.known.get(explanation)

    def tried(self, explanation: Explanation) -> bool:
        """Whether the explanation was refitted, or dropped after a fit on the surrogate, in any order."""
        explanation = self._in_order(explanation)
        label = " + ".join(explanation)
        return explanation in self.known or label in self.left_out or label in self.not_evaluated

    def alone(self, name: str) -> Fitted | None:
        """A fit with this effect alone, for the interval of its size; None if it fails, or would need a
        simulation."""
        if (name,) in self.known:
            return self.known[(name,)].fitted
        if self.facts[name].simulated:
            return None
        try:
            return self._fit((name,))
        except LimbError:
            return None

    def best(self) -> Refit | None:
        """The refit with the lowest chi2 that has no parameter on a bound."""
        usable = [refit for refit in self.known.values() if not refit.fitted.at_bound]
        return min(usable, key=lambda refit: refit.state.chi2) if usable else None

    # ------------------------------------------------------------

    def _in_order(self, explanation: Explanation) -> Explanation:
        """The effects in the candidates' order, so that no combination is refitted twice."""
        return tuple(name for name in self.trials if name in explanation)

    def _refitted(self, several: Sequence[Explanation]) -> list[Refit]:
        drafts = [(each, self._draft(each)) for each in several if each not in self.known]
        found = [(each, fitted) for each, fitted in drafts if fitted is not None]
        chi2 = {each: self.baseline.linearised(fitted).chi2 for each, fitted in found}
        usable = [chi2[each] for each, fitted in found if not fitted.at_bound]
        limit = min(usable, default=math.inf) + thresholds.HOPELESS
        n_simulated = 0
        for each, fitted in sorted(found, key=lambda one: chi2[one[0]]):
            why = "; ".join(fitted.at_bound)
            dear = not why and any(self.facts[name].simulated for name in each)
            if chi2[each] > limit:
                self.left_out[" + ".join(each)] = why or "explains far less than others"
            elif len(each) > 1 and dear and n_simulated == thresholds.MOST_SIMULATED:
                self.left_out[" + ".join(each)] = (
                    f"not simulated: {thresholds.MOST_SIMULATED} that fit better were"
                )
            else:
                n_simulated += dear
                self._settle(each, fitted)
        return [self.known[each] for each in several if each in self.known]

    def _joint(self, explanation: Explanation) -> Trial:
        """Joint trial over the grid points that explain most; over all points for a single effect."""
        if len(explanation) == 1:
            return self.trials[explanation[0]]
        return joint_trial([self._narrowed(name) for name in explanation])

    def _narrowed(self, name: str) -> Trial:
        if name not in self._few:
            self._few[name] = narrowed(self.baseline.state, self.trials[name])
        return self._few[name]

    def _draft(self, explanation: Explanation) -> Fitted | None:
        """The fit on the surrogate; None if it fails, with the reason in `not_evaluated`."""
        try:
            return self._fit(explanation)
        except LimbError as error:
            self.not_evaluated[" + ".join(explanation)] = error.what
            return None

    def _fit(self, explanation: Explanation) -> Fitted:
        """The fit on the surrogate, from the sizes of the first order."""
        found = score(self.baseline.state, self._joint(explanation))
        start = {name: float(eta) for name, eta in zip(found.direction.names, found.eta, strict=False)}
        start |= found.direction.at
        return self.baseline.forward_model.fit(explanation, start)

    def _settle(self, explanation: Explanation, draft: Fitted, *, simulated: bool = True) -> None:
        """Simulate the fitted model if `simulated`, test its residual and store the refit."""
        label = " + ".join(explanation)
        self.baseline.progress.event("note", text=f"refit with {label}")
        fitted = draft
        if simulated:
            try:
                fitted = self.baseline.forward_model.verified(draft)
            except LimbError as error:
                self.not_evaluated[label] = error.what
                return
        refit = self._judged(fitted)
        if refit.fitted.at_bound:
            self.left_out[label] = "; ".join(refit.fitted.at_bound)
        self.known[explanation] = refit

    def _judged(self, fitted: Fitted) -> Refit:
        """The refit with tests of its residual, which allow for the model-form error of its effects."""
        baseline = self.baseline
        whiten = Whitener.of(baseline.data.noise.covariance + baseline.form_error(fitted))

        def anew(direction: Direction) -> Direction:
            return replace(direction, columns=whiten(baseline.whiten.undo(direction.columns)))

        others = [
            Trial(name, tuple(map(anew, trial.directions)))
            for name, trial in self.trials.items() if name not in fitted.explanation
        ]  # fmt: skip
        state = baseline.linearised(fitted)
        family = baseline.family(
            LinearFit.of(
                whiten(baseline.data.y - fitted.prediction), whiten(fitted.jacobian),
                as_it_stands=state.is_held,
            ),
            [*baseline.parts(whiten), *others],
            decisive=(thresholds.LEFT, thresholds.ADEQUATE),
            relative=baseline.is_relative(state),
        )  # fmt: skip
        explained = baseline.state.chi2 - state.chi2
        allowances = form_allowances(baseline.data, fitted, family, whiten, explained)
        return Refit(fitted, state, family, form_allowances=allowances)
