"""Detect, identify, adapt: the whole diagnosis of one set of data on one bench.

1. Fit the base model; look at what is left (all of it, its parts, along every candidate).
2. If something is left beyond chance, refit the candidates that could be behind it and
   those that look like them; keep every explanation that cannot be excluded.
3. One left: named, and added. Several: ambiguous. None: pairs, then triples, else unexplained.
4. Show what shrank, what stays invisible, and which measurement would tell the rest apart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from limbcli.diagnostics.bench import Bench, Explanation, Facts, Fitted
from limbcli.diagnostics.blindspots import BlindSpot, blind_spot
from limbcli.diagnostics.calibrate import N_DRAWS, Family, score_family
from limbcli.diagnostics.explain import Refit, best_pairs, compare, joint_trial
from limbcli.diagnostics.groups import PREFIX, group_trials, predicted_without
from limbcli.diagnostics.heldout import fell, held_out_error
from limbcli.diagnostics.linear import Linearised, Whitener
from limbcli.diagnostics.nextstep import NextStep, rank_proposals
from limbcli.diagnostics.noise import correlated
from limbcli.diagnostics.placebo import library_percentile, placebo_percentile
from limbcli.diagnostics.roughness import Roughness, roughness
from limbcli.diagnostics.score import Direction, Trial, cosine, score
from limbcli.diagnostics.verdict import Diagnosis, Shrink, Word
from limbcli.errors import LimbError
from limbcli.model import Array
from limbcli.progress import SILENT, Progress

ALPHA = 0.05
REFIT_BELOW = 0.2
ALIKE = 0.8
CLOSED_PERCENTILE = 95.0
_ROUGH_P = 0.01
_MAX_REFITS = 16
_FORM_ERROR, _FORM_ALIKE = 0.05, 0.8  # of an effect's own change: another form of it, another mesh
_SEVERAL_PERCENTILE, _MOST_NAMED = 99.0, 2
_HOPELESS = 30.0  # deviance behind the best stand-in: not worth a simulation
_REFIT_DRAWS = 4000  # enough for a test at 2.5 %


def diagnose(
    bench: Bench, *, max_effects: int = 3, seed: int = 7, n_draws: int = N_DRAWS, propose: bool = True,
    progress: Progress = SILENT,
) -> Diagnosis:  # fmt: skip
    """Diagnose one bench. Deterministic for a given seed.

    Raises
    ------
    LimbError
        If the base model itself cannot be fitted.
    """
    return _Run(bench, max_effects, seed, n_draws, propose, progress).all()


@dataclass
class _Run:
    bench: Bench
    max_effects: int
    seed: int
    n_draws: int
    propose: bool
    progress: Progress
    not_evaluated: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    refits: dict[Explanation, Refit] = field(default_factory=dict)
    relative: bool = False

    def __post_init__(self) -> None:
        self.data = self.bench.data
        self.whiten = Whitener.of(self.data.noise.covariance)
        self.facts: dict[str, Facts] = {each.name: each for each in self.bench.candidates}

    # -------------------------------------------------------------- the course of it

    def all(self) -> Diagnosis:
        self.base = self.bench.fit((), {})
        self.state = self._linearised(self.base)
        if self.state.nu < 1:
            return self._finish("untestable", "there are no more data than fitted parameters", None)
        self.rough = self._rough()
        self.relative = self.data.noise.is_assumed or self._noise_is_contradicted()
        trials = self._trials(self.base, self.facts)
        self.trials: dict[str, Trial] = {trial.name: trial for trial in trials}
        self.family = self._family(self.state, [*self._group_trials(), *trials])
        if self.family.smallest >= ALPHA:
            return self._nothing_found()
        kept = self._explanations()
        return self._conclude(kept)

    def _nothing_found(self) -> Diagnosis:
        if self.relative:
            return self._finish("untestable", self._why_relative(), None)
        return self._finish("adequate", "nothing is left beyond the stated noise", None)

    def _conclude(self, kept: list[Refit]) -> Diagnosis:
        if not kept:
            why = "something is left that no candidate, alone or together, explains"
            return self._finish("unexplained", why, None)
        best = min(kept, key=lambda refit: refit.state.chi2)
        if len(kept) > 1:
            why = f"{len(kept)} explanations fit the data and cannot be told apart with them"
            return self._finish("ambiguous", why, best, tuple(kept))
        if not self._is_closed(best):
            why = "the one explanation that fits is no better than any smooth curve, or does not predict"
            return self._finish("unexplained", why, None, tuple(kept))
        failed = [name for name in self._promising() if name in self.not_evaluated]
        if failed:
            why = f"one explanation fits, but {', '.join(failed)} could not be evaluated and may fit too"
            return self._finish("ambiguous", why, best, (best,))
        return self._finish("named", "one explanation fits, and every other is excluded", best, (best,))

    def _explanations(self) -> list[Refit]:
        """The confidence set of the smallest size that is not empty."""
        names = self._promising()
        for size in range(1, self.max_effects + 1):
            several = self._of_size(size, names)
            refits = self._refits(several)
            joint = {each: joint_trial([self.trials[name] for name in each]) for each in several}
            refits = compare(refits, self.base, self.state, joint, self.whiten, rng=self._rng(2),
                             relative=self.relative)  # fmt: skip
            self.refits.update({each.explanation: each for each in refits})
            kept = [each for each in refits if each.in_set and self._each_is_needed(each)]
            if kept:
                return kept
        return []

    def _of_size(self, size: int, names: list[str]) -> list[Explanation]:
        if size == 1:
            return [(name,) for name in names]
        usable = list(self.trials.values())
        if size == 2:
            return [tuple(pair) for pair in best_pairs(self.state, usable)] if len(usable) > 1 else []
        return self._grown(size)

    def _grown(self, size: int) -> list[Explanation]:
        """The best explanation one smaller, with each of the candidates it leaves most for."""
        smaller = [
            r for r in self.refits.values() if len(r.explanation) == size - 1 and not r.fitted.at_bound
        ]
        if not smaller:
            return []
        best = min(smaller, key=lambda refit: refit.state.chi2)
        others = [t for name, t in self.trials.items() if name not in best.explanation]
        order = sorted(others, key=lambda trial: -score(best.state, trial).statistic)
        return [(*best.explanation, trial.name) for trial in order[:3]]

    def _promising(self) -> list[str]:
        """Candidates to refit: those near significance, and those that look like one of them."""
        near = [t.name for t in self.family.tests if t.name in self.trials and t.p_adjusted < REFIT_BELOW]
        alike = [name for name in self.trials if name not in near and any(self._alike(name, k) for k in near)]
        ranked = sorted([*near, *alike], key=lambda name: -self._statistic(name))
        for name in ranked[_MAX_REFITS:]:
            self.left_out[name] = f"not refitted: {_MAX_REFITS} better candidates were"
        return ranked[:_MAX_REFITS]

    def _statistic(self, name: str) -> float:
        found = self.family.of(name)
        return found.score.statistic if found else 0.0

    def _alike(self, first: str, second: str) -> bool:
        a, b = self.family.of(first), self.family.of(second)
        return bool(a and b and abs(cosine(self.state, a.score.direction, b.score.direction)) > ALIKE)

    # -------------------------------------------------------------- pieces

    def _rng(self, stream: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, stream])

    def _linearised(self, fitted: Fitted) -> Linearised:
        return Linearised.of(self.whiten(self.data.y - fitted.prediction), self.whiten(fitted.jacobian))

    def _rough(self) -> Roughness | None:
        return roughness(self.state, self.whiten, channels=self.data.channels(), order=self.data.order)

    def _noise_is_contradicted(self) -> bool:
        return self.rough is not None and self.rough.p < _ROUGH_P

    def _why_relative(self) -> str:
        if self.data.noise.is_assumed:
            return "the noise is assumed: the fit cannot be judged in absolute terms, and no shape stands out"
        return "the data scatter more than their stated noise; no shape stands out of the scatter"

    def _family(self, state: Linearised, trials: Sequence[Trial], *, n_draws: int = 0) -> Family:
        n = n_draws or self.n_draws
        return score_family(state, trials, rng=self._rng(1), relative=self.relative, n_draws=n, alpha=ALPHA)

    def _group_trials(self) -> list[Trial]:
        return group_trials(self.whiten, self.data.groups)

    def _trials(self, fitted: Fitted, facts: Mapping[str, Facts]) -> list[Trial]:
        trials = []
        for k, name in enumerate(facts):
            if name in fitted.explanation:
                continue
            try:
                raw = self.bench.directions(fitted, name)
            except LimbError as error:
                self.not_evaluated[name] = error.what
            else:
                whitened = [Direction(self.whiten(d.columns), d.signs, d.point, d.names) for d in raw]
                if whitened:
                    trials.append(Trial(name, tuple(whitened)))
            self.progress.event("task", name="candidate " + name, done=k + 1, total=len(facts))
        return trials

    def _refits(self, several: Sequence[Explanation]) -> list[Refit]:
        """Refit each on its stand-in; those near the best are then simulated as they stand."""
        drafts = [(each, self._draft(each)) for each in several if each not in self.refits]
        found = [(each, fitted) for each, fitted in drafts if fitted is not None]
        chi2 = {each: self._linearised(fitted).chi2 for each, fitted in found}
        usable = [chi2[each] for each, fitted in found if not fitted.at_bound]
        limit = min(usable, default=math.inf) + _HOPELESS
        for each, fitted in found:
            if chi2[each] <= limit:
                self._settle(each, fitted)
            else:
                self.left_out[" + ".join(each)] = (
                    "; ".join(fitted.at_bound) or "explains far less than others"
                )
        return [self.refits[each] for each in several if each in self.refits]

    def _refit(self, explanation: Explanation) -> Refit | None:
        if explanation not in self.refits:
            fitted = self._draft(explanation)
            if fitted is not None:
                self._settle(explanation, fitted)
        return self.refits.get(explanation)

    def _draft(self, explanation: Explanation) -> Fitted | None:
        """The refit on the stand-in; None (and why) where it has no answer."""
        found = score(self.state, joint_trial([self.trials[name] for name in explanation]))
        start = {name: float(eta) for name, eta in zip(found.direction.names, found.eta, strict=False)}
        try:
            return self.bench.fit(explanation, start)
        except LimbError as error:
            self.not_evaluated[" + ".join(explanation)] = error.what
            return None

    def _settle(self, explanation: Explanation, draft: Fitted) -> None:
        """Simulate the model as fitted, and judge what it leaves."""
        label = " + ".join(explanation)
        self.progress.event("note", text=f"refit with {label}")
        try:
            fitted = self.bench.verified(draft)
        except LimbError as error:
            self.not_evaluated[label] = error.what
            return
        if fitted.at_bound:
            self.left_out[label] = "; ".join(fitted.at_bound)
        self.refits[explanation] = Refit(fitted, self._linearised(fitted), self._left_by(fitted))

    def _left_by(self, fitted: Fitted) -> Family:
        """Tests of what a refit leaves, with room for the effect's own form: it is modelled only roughly."""
        whiten = Whitener.of(self.data.noise.covariance + self._form_error(fitted))

        def anew(direction: Direction) -> Direction:
            return replace(direction, columns=whiten(self.whiten.undo(direction.columns)))

        others = [
            Trial(name, tuple(map(anew, trial.directions)))
            for name, trial in self.trials.items() if name not in fitted.explanation
        ]  # fmt: skip
        state = Linearised.of(whiten(self.data.y - fitted.prediction), whiten(fitted.jacobian))
        trials = [*group_trials(whiten, self.data.groups), *others]
        return self._family(state, trials, n_draws=min(self.n_draws, _REFIT_DRAWS))

    def _form_error(self, fitted: Fitted) -> Array:
        """Covariance (n, n) of an error that is a share of what the effects change, alike at neighbours."""
        change = _FORM_ERROR * np.abs(fitted.prediction - self.base.prediction)
        total = np.zeros((len(change), len(change)))
        for mask in self.data.channels().values():
            part = correlated("form", np.where(mask, change, 0.0), self.data.order, correlation=_FORM_ALIKE,
                              source="computed")  # fmt: skip
            total += part.covariance
        return total

    def _each_is_needed(self, refit: Refit) -> bool:
        """Removal test: without any one member, the rest does not suffice (it was tried, and failed)."""
        if len(refit.explanation) == 1:
            found = self.family.of(refit.explanation[0])
            return (found is not None and found.p_adjusted < REFIT_BELOW) or refit.gap == 0.0
        for name in refit.explanation:
            rest = tuple(each for each in refit.explanation if each != name)
            smaller = self._refit(rest)
            if smaller is not None and not smaller.fitted.at_bound and smaller.is_adequate:
                return False
        return True

    def _is_closed(self, refit: Refit) -> bool:
        before, after = held_out_error(self.data, self.base), held_out_error(self.data, refit.fitted)
        if not fell(before, after) or self._percentile(refit) <= CLOSED_PERCENTILE:
            return False
        if len(refit.explanation) == 1:
            return True
        if len(refit.explanation) > _MOST_NAMED:  # three effects bend to almost any smooth gap
            return False
        return self._library_percentile(refit) > _SEVERAL_PERCENTILE

    def _library_percentile(self, refit: Refit) -> float:
        """Placebos of an explanation by several effects are picked out of as many combinations as it was."""
        n, size = len(self.trials), len(refit.explanation)
        n_parameters = refit.fitted.jacobian.shape[1] - self.base.jacobian.shape[1]
        return library_percentile(
            self.state, self.whiten, self.state.chi2 - refit.state.chi2, n_parameters=n_parameters,
            n_tried=min(math.comb(n, size), 100), channels=self.data.channels(), order=self.data.order,
            deviation=self.data.deviation, rng=self._rng(4),
        )  # fmt: skip

    def _percentile(self, refit: Refit) -> float:
        n_parameters = refit.fitted.jacobian.shape[1] - self.base.jacobian.shape[1]
        return placebo_percentile(
            self.state, self.whiten, self.state.chi2 - refit.state.chi2, n_parameters=max(n_parameters, 1),
            channels=self.data.channels(), order=self.data.order, deviation=self.data.deviation,
            rng=self._rng(3),
        )  # fmt: skip

    # -------------------------------------------------------------- the account

    def _finish(self, word: Word, reason: str, best: Refit | None, kept: tuple[Refit, ...] = ()) -> Diagnosis:
        shown = best or (kept[0] if kept else self._best_partial())
        chosen = best.explanation if best else ()
        family = getattr(self, "family", Family((), None, ALPHA))
        flagged = tuple(
            t.name.removeprefix(PREFIX)
            for t in family.tests
            if t.name.startswith(PREFIX) and t.p_adjusted < ALPHA
        )
        return Diagnosis(
            verdict=word, reason=reason, relative=self.relative, base=self.base, family=family,
            flagged=flagged, refits=tuple(self.refits.values()),
            confidence_set=tuple(r.explanation for r in kept), chosen=chosen,
            closed=word == "named", shrink=self._shrink(shown), blind_spots=self._blind_spots(family),
            next_steps=self._next_steps(kept), angles=self._angles(kept), not_evaluated=self.not_evaluated,
            left_out=self.left_out, roughness=getattr(self, "rough", None), facts=self.facts, seed=self.seed,
            held_out_z=self._held_out_z(),
        )  # fmt: skip

    def _best_partial(self) -> Refit | None:
        usable = [refit for refit in self.refits.values() if not refit.fitted.at_bound]
        return min(usable, key=lambda refit: refit.state.chi2) if usable else None

    def _shrink(self, refit: Refit | None) -> tuple[Shrink, ...]:
        stages = [self._stage(self.base, self.state, None)]
        if refit is None:
            return tuple(stages)
        for size in range(1, len(refit.explanation)):
            part = self._refit(refit.explanation[:size])
            if part is not None:
                stages.append(self._stage(part.fitted, part.state, self._percentile(part)))
        stages.append(self._stage(refit.fitted, refit.state, self._percentile(refit)))
        return tuple(stages)

    def _stage(self, fitted: Fitted, state: Linearised, percentile: float | None) -> Shrink:
        z = (self.data.y - fitted.prediction) / self.data.deviation
        rms = {name: float(np.sqrt(np.mean(z[mask] ** 2))) for name, mask in self.data.channels().items()}
        covariance = np.linalg.pinv(state.jacobian.T @ state.jacobian)
        names = [*fitted.base_names, *fitted.effect_names]
        deviations = {name: float(np.sqrt(max(covariance[k, k], 0.0))) for k, name in enumerate(names)}
        return Shrink(
            fitted.explanation, state.chi2, state.nu, rms, held_out_error(self.data, fitted), fitted.values,
            deviations, percentile,
        )  # fmt: skip

    def _blind_spots(self, family: Family) -> tuple[BlindSpot, ...]:
        spots = []
        for tested in family.tests:
            facts = self.facts.get(tested.name)
            direction = tested.score.direction
            if facts is None or not facts.typical or not direction.names:
                continue
            typical = np.array([facts.typical.get(name, 0.0) for name in direction.names])
            spots.append(
                blind_spot(self.state, tested.name, direction, typical, critical=tested.critical,
                           base_names=self.base.base_names)
            )  # fmt: skip
        return tuple(sorted(spots, key=lambda spot: -spot.detectable_times_typical))

    def _next_steps(self, kept: Sequence[Refit]) -> tuple[NextStep, ...]:
        if len(kept) < 2 or not self.propose:
            return ()
        fits = [refit.fitted for refit in sorted(kept, key=lambda refit: refit.state.chi2)[:5]]
        try:
            proposals = self.bench.proposals(fits)
        except LimbError as error:
            self.not_evaluated["next measurement"] = error.what
            return ()
        return tuple(rank_proposals(fits, proposals, self.whiten))

    def _angles(self, kept: Sequence[Refit]) -> dict[str, float]:
        """Cosines between what the members of the set do to the data, the fitted parameters aside."""
        found = {}
        changes = []
        for refit in kept:
            change = self.whiten(refit.fitted.prediction - self.base.prediction)
            changes.append((" + ".join(refit.explanation), self.state.project(change)))
        for i, (a, x) in enumerate(changes):
            for b, y in changes[i + 1 :]:
                size = float(np.linalg.norm(x) * np.linalg.norm(y))
                found[f"{a} / {b}"] = float(x @ y) / size if size > 0 else 0.0
        return found

    def _held_out_z(self) -> dict[str, tuple[float, float]]:
        residual = self.data.y - self.base.prediction
        found = {}
        for name, mask in self.data.groups.items():
            if 0 < mask.sum() < len(mask) - self.base.jacobian.shape[1]:
                found[name] = predicted_without(
                    residual, self.base.jacobian, self.data.noise.covariance, mask
                )
        return found
