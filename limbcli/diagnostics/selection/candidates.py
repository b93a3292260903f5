"""Selection of the candidates and combinations of candidates to refit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.model.forward_model import Explanation, Facts, Fitted, ForwardModel
from limbcli.diagnostics.model.linear import LinearFit, Whitener
from limbcli.diagnostics.selection.confidence_set import Refit, best_pairs
from limbcli.diagnostics.statistical_tests.multiple_testing import Family
from limbcli.diagnostics.statistical_tests.score import Trial, cosine, score
from limbcli.errors import LimbError
from limbcli.progress import Progress


def whitened_trials(
    forward_model: ForwardModel, fitted: Fitted, facts: Mapping[str, Facts], whiten: Whitener,
    not_evaluated: dict[str, str], progress: Progress,
) -> list[Trial]:  # fmt: skip
    """A trial for each candidate not in the fit; reasons for failures are added to `not_evaluated`."""
    trials = []
    for k, name in enumerate(facts):
        if name in fitted.explanation:
            continue
        try:
            raw = forward_model.directions(fitted, name)
        except LimbError as error:
            not_evaluated[name] = error.what
        else:
            whitened = [replace(each, columns=whiten(each.columns)) for each in raw]
            if whitened:
                trials.append(Trial(name, tuple(whitened)))
        progress.event("task", name="candidate " + name, done=k + 1, total=len(facts))
    return trials


def is_gross(state: LinearFit) -> bool:
    """Whether the residual of the fit without effects exceeds the stated noise by far, so that its parameters
    are unreliable."""
    return state.nu > 0 and state.chi2 > thresholds.GROSS * state.nu


def closes_gross(state: LinearFit, left: LinearFit) -> bool:
    """Whether an effect reduces the chi2 of a grossly wrong fit to a small fraction (`left`).

    This is sufficient evidence even if the stated noise is too small, as no effect would reduce the excess
    scatter.
    """
    return is_gross(state) and left.chi2 < state.chi2 / thresholds.GROSS


@dataclass(frozen=True, eq=False)
class Candidates:
    """The trials of all candidates at the fit without effects, and their tests."""

    state: LinearFit
    trials: Mapping[str, Trial]
    family: Family

    def promising(self, left_out: dict[str, str]) -> list[str]:
        """Candidates near significance and those with similar sensitivities; the excess goes into `left_out`.

        If none is significant, at least the `GROWN` nearest are included. All candidates are included if the
        fit without effects is grossly wrong: its parameters are then unreliable, and first-order
        sensitivities there say little about the effects.
        """
        ranks = sorted((t for t in self.family.tests if t.name in self.trials), key=lambda t: t.p_adjusted)
        near = [t.name for t in ranks if t.p_adjusted < thresholds.REFIT_BELOW]
        if not any(t.p_adjusted < thresholds.ALPHA for t in ranks):
            # A part of the data is significant but no candidate is: a strong effect may still explain it, as
            # the first-order test underestimates strong effects.
            near = [t.name for t in ranks[: max(len(near), thresholds.GROWN)]]
        others = [name for name in self.trials if name not in near]
        alike = [name for name in others if is_gross(self.state) or any(self._alike(name, k) for k in near)]
        ranked = sorted([*near, *alike], key=lambda name: -self._statistic(name))
        for name in ranked[thresholds.MAX_REFITS :]:
            left_out[name] = f"not refitted: {thresholds.MAX_REFITS} better candidates were"
        return ranked[: thresholds.MAX_REFITS]

    def of_size(self, size: int, names: list[str], refits: Iterable[Refit]) -> list[Explanation]:
        """Explanations by `size` effects that are worth a refit."""
        if size == 1:
            return [(name,) for name in names]
        usable = list(self.trials.values())
        if size == 2:
            return [tuple(pair) for pair in best_pairs(self.state, usable)] if len(usable) > 1 else []
        return self._grown(size, refits)

    def _grown(self, size: int, refits: Iterable[Refit]) -> list[Explanation]:
        """The best explanation with one effect less, extended by each of the candidates that score highest on
        its residual."""
        smaller = [r for r in refits if len(r.explanation) == size - 1 and not r.fitted.at_bound]
        if not smaller:
            return []
        best = min(smaller, key=lambda refit: refit.state.chi2)
        others = [t for name, t in self.trials.items() if name not in best.explanation]
        order = sorted(others, key=lambda trial: -score(best.state, trial).statistic)
        return [(*best.explanation, trial.name) for trial in order[: thresholds.GROWN]]

    def extended(self, refit: Refit, *, below: float) -> list[Explanation]:
        """The explanation with one further effect, if its residual has a p below `below`: the candidates with
        the smallest adjusted p."""
        if refit.left_p >= below:
            return []
        left = [
            t for t in refit.family.tests if t.name in self.trials and t.p_adjusted < thresholds.REFIT_BELOW
        ]
        left.sort(key=lambda t: (t.p_adjusted, -t.score.statistic))
        return [(*refit.explanation, t.name) for t in left[: thresholds.GROWN]]

    def next_extensions(self, refit: Refit, tried: Mapping[Explanation, Refit]) -> list[Explanation]:
        """The explanation with the further effects that score highest among the untried ones, if no extension
        that was tried gains a share `BORNE_OUT` of what its score on the residual promises.

        tried : all refits, with their effects in any order
        """
        scores = {t.name: t.score.statistic for t in refit.family.tests if t.name in self.trials}
        gains = {
            name: refit.state.chi2 - each.state.chi2
            for each in tried.values() if len(each.explanation) == len(refit.explanation) + 1
            for name in set(each.explanation) - set(refit.explanation)
            if set(refit.explanation) < set(each.explanation)
        }  # fmt: skip
        if any(gains[name] >= thresholds.BORNE_OUT * scores.get(name, np.inf) for name in gains):
            return []
        left = [name for name in scores if name not in gains and scores[name] > thresholds.NEEDED]
        left.sort(key=lambda name: -scores[name])
        return [(*refit.explanation, name) for name in left[: thresholds.GROWN]]

    def rival_extensions(self, refit: Refit) -> list[Explanation]:
        """The explanation, which a larger one beats, with each further effect whose score on its residual may
        bring it within the allowed gap of the best: at most `PAIRS_KEPT`, those that score highest."""
        left = [
            t for t in refit.family.tests
            if t.name in self.trials and t.score.statistic > refit.gap_beyond_chance
        ]  # fmt: skip
        left.sort(key=lambda t: -t.score.statistic)
        return [(*refit.explanation, t.name) for t in left[: thresholds.PAIRS_KEPT]]

    def exchanged(self, refits: Sequence[Refit]) -> list[Explanation]:
        """These explanations with one effect replaced by a similar one, the most similar first."""
        found: dict[frozenset[str], tuple[float, Explanation]] = {}
        for refit in refits:
            for name in refit.explanation:
                for other in self.trials:
                    alike = 0.0 if other in refit.explanation else self._likeness(other, name)
                    new = tuple(other if each == name else each for each in refit.explanation)
                    if alike > found.get(frozenset(new), (thresholds.ALIKE, new))[0]:
                        found[frozenset(new)] = alike, new
        return [new for _, new in sorted(found.values(), key=lambda each: -each[0])]

    def _statistic(self, name: str) -> float:
        found = self.family.of(name)
        return found.score.statistic if found else 0.0

    def _alike(self, first: str, second: str) -> bool:
        return self._likeness(first, second) > thresholds.ALIKE

    def _likeness(self, first: str, second: str) -> float:
        """|cosine| between the best directions of the two effects; 0 if either was not tested."""
        a, b = self.family.of(first), self.family.of(second)
        return abs(cosine(self.state, a.score.direction, b.score.direction)) if a and b else 0.0
