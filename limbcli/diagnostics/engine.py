"""Detect, identify, adapt: the whole diagnosis of one set of data on one forward model.

1. Fit the base model; look at what is left (all of it, its parts, along every candidate).
2. If something is left beyond chance, refit the candidates that could be behind it and
   those that look like them; keep every explanation that cannot be excluded. Where nothing but candidates
   stood out, to first order, and no refit bears that out, nothing is found.
3. One left, or one that all others contain: named, and added. Several: ambiguous. None: pairs, then triples,
   else unexplained.
4. Show what shrank, what stays invisible, and which measurement would distinguish the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.conclusions.account import Account
from limbcli.diagnostics.conclusions.verdict import Diagnosis, Word
from limbcli.diagnostics.model.forward_model import Facts, ForwardModel
from limbcli.diagnostics.selection.baseline_fit import BaselineFit
from limbcli.diagnostics.selection.candidates import Candidates, closes_gross, whitened_trials
from limbcli.diagnostics.selection.confidence_set import Refit
from limbcli.diagnostics.selection.gap_closure import Closing
from limbcli.diagnostics.selection.refits import Refits
from limbcli.diagnostics.statistical_tests.localisation_tests import PREFIX
from limbcli.diagnostics.statistical_tests.multiple_testing import Family, Tested
from limbcli.diagnostics.statistical_tests.score import Trial
from limbcli.interval_limits import noise_scale
from limbcli.progress import SILENT, Progress


def diagnose(
    forward_model: ForwardModel, *, max_effects: int = 3, seed: int = 7, n_draws: int = thresholds.N_DRAWS,
    propose: bool = True, progress: Progress = SILENT,
) -> Diagnosis:  # fmt: skip
    """Diagnose one forward model. Deterministic for a given seed.

    Raises
    ------
    LimbError
        If the base model itself cannot be fitted.
    """
    baseline = BaselineFit(forward_model, forward_model.fit((), {}), seed, n_draws, progress)
    return _Run(baseline, max_effects, propose).all()


@dataclass(eq=False)
class _Run:
    baseline: BaselineFit
    max_effects: int
    propose: bool
    not_evaluated: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    family: Family = field(default_factory=lambda: Family((), None, thresholds.ALPHA))
    trials: dict[str, Trial] = field(default_factory=dict)
    refits: Refits | None = None

    def all(self) -> Diagnosis:
        baseline = self.baseline
        self.facts: dict[str, Facts] = {each.name: each for each in baseline.forward_model.candidates}
        if baseline.state.nu < 1:
            return self._finish("untestable", "there are no more data than fitted parameters", None)
        trials = whitened_trials(
            baseline.forward_model,
            baseline.base,
            self.facts,
            baseline.whiten,
            self.not_evaluated,
            baseline.progress,
        )
        self.trials = {trial.name: trial for trial in trials}
        self.family = self._tested(trials)
        if self.family.smallest >= thresholds.ALPHA:
            return self._nothing_found()
        self.refits = Refits(baseline, self.trials, self.facts, self.not_evaluated, self.left_out)
        candidates = Candidates(baseline.state, self.trials, self.family)
        promising = candidates.promising(self.left_out)
        singles = self.refits.compared(candidates.of_size(1, promising, ()))
        if self._is_borne_out_by_none(singles):
            names = ", ".join(each.name for each in self._significant)
            return self._nothing_found(
                f"; what was significant to first order ({names}) is not confirmed by a refit"
            )
        kept = self._explanations(candidates, promising, self.refits, singles)
        return self._conclude(kept, promising)

    def _tested(self, trials: list[Trial]) -> Family:
        baseline = self.baseline
        parts = baseline.parts(baseline.whiten)
        return baseline.family(baseline.state, [*parts, *trials], relative=baseline.relative)

    @property
    def _significant(self) -> list[Tested]:
        return [each for each in self.family.tests if each.p_adjusted < thresholds.ALPHA]

    def _is_borne_out_by_none(self, singles: Sequence[Refit]) -> bool:
        """Whether all that is significant are effects to first order, none of which gains as much when it is
        refitted: then nothing is found."""
        overall = self.family.overall
        if overall is not None and overall.p_adjusted < thresholds.ALPHA:
            return False
        refitted = {each.explanation: each for each in singles}
        return all(
            (each.name,) in refitted and self._borne_out(each, refitted[(each.name,)]) >= thresholds.ALPHA
            for each in self._significant
        )

    def _explanations(
        self, candidates: Candidates, names: list[str], refits: Refits, singles: list[Refit]
    ) -> list[Refit]:
        """The confidence set of the smallest size that is not empty, and what it may still lack.

        singles : those of one effect, compared
        """
        for size in range(1, self.max_effects + 1):
            compared = singles
            if size > 1:
                compared = refits.compared(candidates.of_size(size, names, refits.known.values()))
                compared = self._with_look_alikes(compared, candidates, refits)
            kept = [each for each in compared if each.in_set and self._each_is_needed(each, refits)]
            kept += [r for r in compared if r.is_close_to(kept) and self._each_is_needed(r, refits)]
            if kept:
                return self._repeated(kept, candidates, refits) if size < self.max_effects else kept
        return []

    def _with_look_alikes(self, compared: list[Refit], candidates: Candidates, refits: Refits) -> list[Refit]:
        """Beside the best of several effects those with one of them exchanged for its look-alike, if untried.

        A pair's rank is that of its first-order score without either effect, and that order fails for
        strong ones.
        """
        several = [r for r in compared if len(r.explanation) > 1 and not r.fitted.at_bound]
        usable = sorted(several, key=lambda r: r.state.chi2)
        new = [
            each for each in candidates.exchanged(usable[: thresholds.EXCHANGED]) if not refits.tried(each)
        ]
        if not new:
            return compared
        return refits.compared([*(refit.explanation for refit in compared), *new[: thresholds.LOOK_ALIKES]])

    def _repeated(self, kept: list[Refit], candidates: Candidates, refits: Refits) -> list[Refit]:
        """Where a member leaves a hint of more (`SECOND`), one more effect is tried with it.

        Of two effects the second is weak evidence once the first has moved c and m. So a
        member stays beside its own extension: both are reported.
        """
        found = [each for refit in kept for each in candidates.extended(refit, below=thresholds.SECOND)]
        larger = list({frozenset(each): each for each in found}.values())
        if not larger:
            return kept
        compared = refits.compared([*(refit.explanation for refit in kept), *larger])
        compared = self._with_look_alikes(compared, candidates, refits)
        first = {refit.explanation for refit in kept}
        return [
            each for each in compared
            if each.explanation in first
            or (each.in_set and self._each_is_needed(each, refits, thresholds.SECOND))
        ]  # fmt: skip

    def _each_is_needed(self, refit: Refit, refits: Refits, level: float = thresholds.ADEQUATE) -> bool:
        """Removal test: without any one member, the rest does not suffice (it was tried, and failed).

        One effect alone needs evidence of its own, or fits as well as the best, whose evidence is its, too.
        """
        if len(refit.explanation) == 1:
            found = self.family.of(refit.explanation[0])
            if found is not None and found.p_adjusted < thresholds.REFIT_BELOW:
                return True
            as_well = refit.gap is not None and refit.gap < thresholds.AS_WELL
            return as_well or closes_gross(self.baseline.state, refit.state)
        for name in refit.explanation:
            smaller = refits.of(tuple(each for each in refit.explanation if each != name))
            if smaller is None or smaller.fitted.at_bound:
                continue
            if smaller.left_p >= level:
                return False
        return True

    # -------------------------------------------------------------- verdicts

    def _nothing_found(self, but: str = "") -> Diagnosis:
        """but : what was looked at and dismissed"""
        if not self.baseline.relative:
            return self._finish("adequate", f"no residual remains beyond the stated noise{but}", None)
        if self.baseline.data.noise.is_assumed:
            why = (
                "the noise is assumed: the fit cannot be judged in absolute terms, and no residual "
                "pattern is significant"
            )
        else:
            why = (
                "the data scatter more than their stated noise; no residual pattern is significant "
                "against the scatter"
            )
        return self._finish("untestable", f"{why}{but}", None)

    def _conclude(self, kept: list[Refit], promising: list[str]) -> Diagnosis:
        if not kept:
            why = "a residual remains that no candidate, alone or combined, explains"
            return self._finish("unexplained", why, None)
        best = min(kept, key=lambda refit: (len(refit.explanation), not refit.is_adequate, refit.state.chi2))
        objection = self._why_not_named(best, kept, promising)
        if len(kept) == 1 and objection is not None:
            word, but = objection
            why = f"one explanation fits, but {but}"
            return self._finish(word, why, best if word == "ambiguous" else None, tuple(kept))
        if len(kept) == 1:
            return self._finish(
                "named", "one explanation fits, and no other that was tried does", best, (best,)
            )
        if not all(set(best.explanation) <= set(each.explanation) for each in kept):
            why = f"{len(kept)} explanations fit the data, which cannot distinguish them"
            return self._finish("ambiguous", why, best, tuple(kept))
        has = f"every explanation that fits includes {' + '.join(best.explanation)}"
        if objection is None:
            why = f"{has}; these data do not show whether a further effect is present"
            return self._finish("named", why, best, tuple(kept))
        return self._finish("ambiguous", f"{has}, but {objection[1]}", best, tuple(kept))

    def _why_not_named(
        self, best: Refit, kept: Sequence[Refit], promising: list[str]
    ) -> tuple[Word, str] | None:
        """What to say instead of a name, and why ("it fits, but ..."); None: nothing speaks against it.

        What it leaves may be that of one effect more: then an explanation with both leaves nothing. An m on
        its bound is an objection only where it is reported there: by a flat fit, another value is reported.
        """
        if not self._speaks_for_itself(best):
            return "unexplained", "it is not significant by itself, and the significant ones do not fit"
        if not Closing(self.baseline, self._n_candidates).is_closed(best):
            return "unexplained", (
                "it fits no better than an arbitrary smooth curve, or does not predict held-out data"
            )
        larger = [each for each in kept if set(best.explanation) <= set(each.explanation)]
        if max(each.left_p for each in larger) < thresholds.LEFT:
            return "ambiguous", "a residual remains; it may not be the full explanation"
        chance = self._chance_of(best, times=thresholds.NAMED_BY_GAIN)
        if chance >= thresholds.NAMED:
            return "ambiguous", f"its own evidence is too weak to name it (p {chance:.2g})"
        if best.fitted.notes and not Account(self.baseline).estimates(best.fitted, best.state).is_pulled:
            return "ambiguous", f"with it {best.fitted.notes[0]}"
        failed = [name for name in promising if name in self.not_evaluated]
        if failed:
            return "ambiguous", f"{', '.join(failed)} could not be evaluated and may also fit"
        rivals = [
            label for label, refit in self._at_bounds() if len(refit.explanation) == len(best.explanation)
        ]
        if rivals:
            return "ambiguous", f"{', '.join(rivals)} would also fit, with a size at its bound"
        return None

    def _at_bounds(self) -> list[tuple[str, Refit]]:
        """Refits that fit as well as the best but for a parameter on a bound: hardly believed, yet not
        excluded either. What fits worse, and needs a size that is hardly believed, is."""
        known = self.refits.known.values() if self.refits else ()
        return [
            (" + ".join(r.explanation), r)
            for r in known
            if r.fitted.at_bound and r.fits and r.gap is not None and r.gap < thresholds.AS_WELL
        ]

    def _speaks_for_itself(self, refit: Refit) -> bool:
        """A name needs evidence of its own: what was found may be that of another, dropped since."""
        return self._chance_of(refit) < thresholds.ALPHA

    def _chance_of(self, refit: Refit, *, times: float = 1.0) -> float:
        """p of its own evidence: of the first order at no effect, as far as its refit bears that out, or of
        the gain of its refit (that p so many `times`), where the first order shows less of it.

        0 for several effects, each of which was needed, and where the fit without effects is grossly wrong:
        that little of it is left is evidence enough.
        """
        if len(refit.explanation) > 1 or closes_gross(self.baseline.state, refit.state):
            return 0.0
        found = self.family.of(refit.explanation[0])
        of_gain = min(times * self._gain_p(refit), 1.0)
        return of_gain if found is None else min(self._borne_out(found, refit), of_gain)

    def _borne_out(self, found: Tested, refit: Refit) -> float:
        """Adjusted p of a first-order score, or of the gain of the refit where that is less: along the tail
        of chi2, of as many tests.

        In units of the scatter that stays, where the noise's level is not known.
        """
        unit = self._scatter(refit) if self.baseline.relative else 1.0
        gain = (self.baseline.state.chi2 - refit.state.chi2) / unit + thresholds.SLACK
        promised, n = found.score.statistic / unit, max(len(found.score.direction.names), 1)
        if gain >= promised:
            return found.p_adjusted
        times = np.exp(chi2_distribution.logsf(max(gain, 0.0), n) - chi2_distribution.logsf(promised, n))
        return float(-np.expm1(times * np.log1p(-min(found.p_adjusted, 1.0 - 1e-12))))

    @staticmethod
    def _scatter(refit: Refit) -> float:
        """By how much the variance that stays is larger than stated; at least 1."""
        return noise_scale(refit.state.chi2, refit.state.nu)

    def _gain_p(self, refit: Refit) -> float:
        """That a refit of any candidate gains as much by chance.

        Likelihood ratio, in units of the scatter that stays, of as many tests as there are grid points.
        """
        gain = (self.baseline.state.chi2 - refit.state.chi2) / self._scatter(refit)
        trials = self.refits.trials.values() if self.refits else ()
        n_tests = max(sum(len(trial.directions) for trial in trials), 1)
        p = float(chi2_distribution.sf(max(gain, 0.0), max(len(refit.fitted.effect_names), 1)))
        return float(-np.expm1(n_tests * np.log1p(-min(p, 1.0 - 1e-12))))

    @property
    def _n_candidates(self) -> int:
        return len(self.refits.trials) if self.refits else 0

    def _finish(self, word: Word, reason: str, best: Refit | None, kept: tuple[Refit, ...] = ()) -> Diagnosis:
        baseline, account = self.baseline, Account(self.baseline)
        fits_best = self.refits.best() if self.refits and word == "unexplained" else None
        shown = best or (kept[0] if kept else fits_best)
        flagged = tuple(
            t.name.removeprefix(PREFIX)
            for t in self.family.tests
            if t.name.startswith(PREFIX) and t.p_adjusted < thresholds.ALPHA
        )
        shrink = account.shrink(shown, self.refits, kept if word in ("named", "ambiguous") else ())
        relative = baseline.relative if best is None else baseline.is_relative(best.state)
        return Diagnosis(
            verdict=word, reason=reason, relative=relative, base=baseline.base, family=self.family,
            flagged=flagged, refits=tuple(self.refits.known.values()) if self.refits else (),
            confidence_set=tuple(r.explanation for r in kept), chosen=best.explanation if best else (),
            closed=word == "named", shrink=shrink,
            blind_spots=account.blind_spots(self.family, self.facts),
            next_steps=account.next_steps(kept, self.not_evaluated) if self.propose else (),
            angles=account.angles(kept), not_evaluated=self.not_evaluated, left_out=self.left_out,
            roughness=baseline.rough, facts=self.facts, seed=baseline.seed, held_out_z=account.held_out_z(),
            sizes=account.sizes_95(self.family, self.facts, self.trials),
            refitted_sizes=account.refitted_sizes(self.refits, shrink),
        )  # fmt: skip
