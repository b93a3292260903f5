"""Which candidates are worth a refit, alone and together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

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
    """A trial of each candidate that is not in the fit; why not, in `not_evaluated`."""
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
    """A fit without effects that is wrong far beyond the stated noise: it may have ended anywhere."""
    return state.nu > 0 and state.chi2 > thresholds.GROSS * state.nu


def closes_gross(state: LinearFit, left: LinearFit) -> bool:
    """An effect leaves (`left`) a small part of what such a fit leaves: evidence of its own, also where the
    stated noise is too small, which no effect makes less."""
    return is_gross(state) and left.chi2 < state.chi2 / thresholds.GROSS


@dataclass(frozen=True, eq=False)
class Candidates:
    """The trials of all candidates at the fit without effects, and their tests."""

    state: LinearFit
    trials: Mapping[str, Trial]
    family: Family

    def promising(self, left_out: dict[str, str]) -> list[str]:
        """Those near significance, with the nearest where none is significant, and those that look like one
        of them; the rest goes into `left_out`.

        All, where the fit without effects is grossly wrong: it may have ended anywhere, and what the
        effects do to first order there shows little of what they do.
        """
        ranks = sorted((t for t in self.family.tests if t.name in self.trials), key=lambda t: t.p_adjusted)
        near = [t.name for t in ranks if t.p_adjusted < thresholds.REFIT_BELOW]
        if not any(t.p_adjusted < thresholds.ALPHA for t in ranks):
            # What a part of the data shows and no candidate does, one may explain that is strong: the first
            # order shows little of it.
            near = [t.name for t in ranks[: max(len(near), thresholds.GROWN)]]
        others = [name for name in self.trials if name not in near]
        alike = [name for name in others if is_gross(self.state) or any(self._alike(name, k) for k in near)]
        ranked = sorted([*near, *alike], key=lambda name: -self._statistic(name))
        for name in ranked[thresholds.MAX_REFITS :]:
            left_out[name] = f"not refitted: {thresholds.MAX_REFITS} better candidates were"
        return ranked[: thresholds.MAX_REFITS]

    def of_size(self, size: int, names: list[str], refits: Iterable[Refit]) -> list[Explanation]:
        """Explanations by so many effects that are worth a refit."""
        if size == 1:
            return [(name,) for name in names]
        usable = list(self.trials.values())
        if size == 2:
            return [tuple(pair) for pair in best_pairs(self.state, usable)] if len(usable) > 1 else []
        return self._grown(size, refits)

    def _grown(self, size: int, refits: Iterable[Refit]) -> list[Explanation]:
        """The best explanation one smaller, with each of the candidates it leaves most for."""
        smaller = [r for r in refits if len(r.explanation) == size - 1 and not r.fitted.at_bound]
        if not smaller:
            return []
        best = min(smaller, key=lambda refit: refit.state.chi2)
        others = [t for name, t in self.trials.items() if name not in best.explanation]
        order = sorted(others, key=lambda trial: -score(best.state, trial).statistic)
        return [(*best.explanation, trial.name) for trial in order[: thresholds.GROWN]]

    def extended(self, refit: Refit, *, below: float) -> list[Explanation]:
        """The same with one more effect, where what it leaves is significant: those it leaves most for."""
        if refit.left_p >= below:
            return []
        left = [
            t for t in refit.family.tests if t.name in self.trials and t.p_adjusted < thresholds.REFIT_BELOW
        ]
        left.sort(key=lambda t: (t.p_adjusted, -t.score.statistic))
        return [(*refit.explanation, t.name) for t in left[: thresholds.GROWN]]

    def exchanged(self, refits: Sequence[Refit]) -> list[Explanation]:
        """These with one effect exchanged for another that looks like it, the most alike first."""
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
        """|cosine| of the two effects' best directions; 0 where one has none."""
        a, b = self.family.of(first), self.family.of(second)
        return abs(cosine(self.state, a.score.direction, b.score.direction)) if a and b else 0.0
