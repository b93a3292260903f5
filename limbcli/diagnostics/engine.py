"""Detect, identify, adapt: the complete diagnosis of one data set with one forward model.

1. Fit the base model and test its residual: as a whole, in each part of the data, and along the
   sensitivities of every candidate effect.
2. If the residual is significant, refit the candidates that could cause it and those with similar
   sensitivities, and keep every explanation that cannot be excluded. If only first-order tests of candidates
   were significant and no refit confirms them, the diagnosis reports that nothing was found.
3. If one explanation remains, or one that all the others contain, it is named and added to the model. If
   several remain, the verdict is ambiguous. If none remains, pairs and then triples of effects are tried; if
   these fail as well, the verdict is unexplained.
4. Report how much of the residual each addition removes, which effects remain undetectable, and which
   further measurement would distinguish the remaining explanations.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.conclusions.account import Account
from limbcli.diagnostics.conclusions.verdict import Diagnosis, Word
from limbcli.diagnostics.model.forward_model import Explanation, Facts, ForwardModel
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
        """Whether the only significant tests are first-order tests of candidates and no refit confirms them.

        A refit confirms a candidate if it reduces chi2 by about as much as the first-order test predicts. If
        none does, the diagnosis reports that nothing was found.
        """
        overall = self.family.overall
        if overall is not None and overall.p_adjusted < thresholds.ALPHA:
            return False
        refitted = {each.explanation: each for each in singles}
        return all(
            (each.name,) in refitted
            and self._borne_out(each.p_adjusted, each, refitted[(each.name,)]) >= thresholds.ALPHA
            for each in self._significant
        )

    def _explanations(
        self, candidates: Candidates, names: list[str], refits: Refits, singles: list[Refit]
    ) -> list[Refit]:
        """The non-empty confidence set with the fewest effects, extended by members with one further effect.

        singles : the compared refits of one effect each
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
        """Add untried variants of the best combinations, with one effect replaced by a similar effect.

        Pairs are ranked by their first-order score at the fit without effects, and this ranking is
        unreliable for strong effects.
        """
        several = [r for r in compared if len(r.explanation) > 1 and not r.fitted.at_bound]
        usable = sorted(several, key=lambda r: r.state.chi2)
        new = candidates.exchanged(usable[: thresholds.EXCHANGED])
        return _with_untried(compared, new, refits, most=thresholds.LOOK_ALIKES)

    def _repeated(self, kept: list[Refit], candidates: Candidates, refits: Refits) -> list[Refit]:
        """Extend members whose residual hints at a further effect (p below `SECOND`) by one more effect.

        The evidence for the second of two effects is weak once the first has changed c and m. A member
        therefore stays in the set together with its own extension, and both are reported. If the extension
        beats it, a second effect is there, but not necessarily that one: all that may fit as well are tried.
        If no extension gains what its score promises, those that score next are tried.
        """
        found = [each for refit in kept for each in candidates.extended(refit, below=thresholds.SECOND)]
        larger = _each_once(found)
        if not larger:
            return kept
        compared = refits.compared([*(refit.explanation for refit in kept), *larger])
        compared = self._with_look_alikes(compared, candidates, refits)
        first = {refit.explanation for refit in kept}
        compared = self._with_next_extensions(compared, first, candidates, refits)
        beaten = [each for each in compared if each.explanation in first and each.is_beaten]
        compared = self._with_rival_extensions(compared, beaten, candidates, refits)
        return [
            each for each in compared
            if each.explanation in first
            or (each.in_set and self._each_is_needed(each, refits, thresholds.SECOND))
        ]  # fmt: skip

    def _with_next_extensions(
        self, compared: list[Refit], first: Collection[Explanation], candidates: Candidates, refits: Refits
    ) -> list[Refit]:
        """Add extensions of these members by the effects that score next, where the tried ones are not borne
        out and none of them beats the member."""
        hinting = [
            refit for refit in compared
            if refit.explanation in first and refit.left_p < thresholds.SECOND and not refit.is_beaten
        ]  # fmt: skip
        new = [each for refit in hinting for each in candidates.next_extensions(refit, refits.known)]
        return _with_untried(compared, new, refits)

    def _with_rival_extensions(
        self, compared: list[Refit], beaten: Sequence[Refit], candidates: Candidates, refits: Refits
    ) -> list[Refit]:
        """Add the untried extensions of beaten refits that may fit as well as those that beat them.

        More rivals allow a larger gap. This does not undo that one of them alone has beaten a refit.
        """
        new = [each for refit in beaten for each in candidates.rival_extensions(refit)]
        found = _with_untried(compared, new, refits)
        refits.known |= {each.explanation: each for each in beaten}
        return [refits.known[each.explanation] for each in found]

    def _each_is_needed(self, refit: Refit, refits: Refits, level: float = thresholds.ADEQUATE) -> bool:
        """Removal test: whether the explanation fails if any one of its effects is removed (by a refit).

        It does not fail if the rest is adequate and fits as well within `NEEDED`, whatever it leaves.
        A single effect is needed if it has evidence of its own, or if it fits as well as the best
        explanation, whose evidence then supports it equally.
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
            gain = smaller.state.chi2 - refit.state.chi2
            if smaller.left_p >= level or (smaller.is_adequate and gain < thresholds.NEEDED):
                return False
        return True

    # -------------------------------------------------------------- verdicts

    def _nothing_found(self, but: str = "") -> Diagnosis:
        """but : text on what was significant to first order and dismissed after a refit"""
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
        """The verdict to give instead of "named", and the reason ("it fits, but ..."); None if no objection.

        An m on its bound is an objection only if that value is reported: where the fit is flat in m, the weak
        prior moves the reported value off the bound.
        """
        if not self._speaks_for_itself(best):
            return "unexplained", "it is not significant by itself, and the significant ones do not fit"
        if not Closing(self.baseline, self._n_candidates).is_closed(best):
            return "unexplained", (
                "it fits no better than an arbitrary smooth curve, or does not predict held-out data"
            )
        larger = [each for each in kept if set(best.explanation) <= set(each.explanation)]
        if best.left_p < thresholds.LEFT:
            if max(each.left_p for each in larger) < thresholds.LEFT:
                return "ambiguous", "a residual remains; it may not be the full explanation"
            return "ambiguous", "it leaves a residual that one further effect explains"
        if best.is_beaten:
            better = min(larger, key=lambda refit: refit.state.chi2)
            return "ambiguous", f"{' + '.join(better.explanation)} fits better than chance allows"
        chance = self._chance_of(best, times=thresholds.NAMED_BY_GAIN, among_effects=True)
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
        """Refits that fit as well as the best, but with a parameter on a bound.

        They are implausible but not excluded. Refits that fit worse and also need an implausible size are
        excluded.
        """
        known = self.refits.known.values() if self.refits else ()
        return [
            (" + ".join(r.explanation), r)
            for r in known
            if r.fitted.at_bound and r.fits and r.gap is not None and r.gap < thresholds.AS_WELL
        ]

    def _speaks_for_itself(self, refit: Refit) -> bool:
        """Whether the explanation itself is significant, which naming it requires.

        The detected residual may be evidence for another candidate that has been dropped since.
        """
        return self._chance_of(refit) < thresholds.ALPHA

    def _chance_of(self, refit: Refit, *, times: float = 1.0, among_effects: bool = False) -> float:
        """p of the evidence for this explanation itself.

        among_effects : adjusted over the effects alone, for the question which of them it is; tests of parts
            of the data only say whether there is any

        The smaller of two: the first-order p at the fit without effects, weakened where the refit gains less
        than predicted; and the p of the refit's gain, multiplied by `times`.

        0 for an explanation by several effects, each of which has passed the removal test, and where the fit
        without effects is grossly wrong and this refit removes most of its chi2, which is sufficient
        evidence.
        """
        if len(refit.explanation) > 1 or closes_gross(self.baseline.state, refit.state):
            return 0.0
        found = self.family.of(refit.explanation[0])
        of_gain = min(times * self._gain_p(refit), 1.0)
        if found is None:
            return of_gain
        p = found.p_among if among_effects else found.p_adjusted
        return min(self._borne_out(p, found, refit), of_gain)

    def _borne_out(self, p: float, found: Tested, refit: Refit) -> float:
        """Adjusted p of a first-order score, weakened where the refit gains less than the score predicts.

        The p is moved along the tail of the chi2 distribution for the same number of tests. Where the noise
        level is unknown, both statistics are scaled by the scatter that remains after the refit.
        """
        unit = self._scatter(refit) if self.baseline.relative else 1.0
        gain = (self.baseline.state.chi2 - refit.state.chi2) / unit + thresholds.SLACK
        promised, n = found.score.statistic / unit, max(len(found.score.direction.names), 1)
        if gain >= promised:
            return p
        times = np.exp(chi2_distribution.logsf(max(gain, 0.0), n) - chi2_distribution.logsf(promised, n))
        return float(-np.expm1(times * np.log1p(-min(p, 1.0 - 1e-12))))

    @staticmethod
    def _scatter(refit: Refit) -> float:
        """Ratio of the residual variance after the refit to the stated variance; at least 1."""
        return noise_scale(refit.state.chi2, refit.state.nu)

    def _gain_p(self, refit: Refit) -> float:
        """Probability that a refit of any candidate gains as much by chance.

        Likelihood-ratio test, scaled by the scatter that remains, adjusted for as many tests as there are
        grid points.
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
        of_sizes = self.refits or Refits(baseline, self.trials, self.facts, {}, {})
        refitted = tuple(self.refits.known.values()) if self.refits else ()
        return Diagnosis(
            verdict=word, reason=reason, relative=relative, base=baseline.base, family=self.family,
            flagged=flagged, refits=refitted,
            confidence_set=tuple(r.explanation for r in kept), chosen=best.explanation if best else (),
            closed=word == "named", shrink=shrink,
            blind_spots=account.blind_spots(self.family, self.facts),
            next_steps=account.next_steps(kept, self.not_evaluated) if self.propose else (),
            angles=account.angles(kept), not_evaluated=self.not_evaluated, left_out=self.left_out,
            roughness=baseline.rough, facts=self.facts, seed=baseline.seed, held_out_z=account.held_out_z(),
            sizes=account.sizes_95(self.family, self.facts, self.trials),
            refitted_sizes=account.refitted_sizes(of_sizes, shrink),
            common_errors=account.common_errors(refitted),
        )  # fmt: skip


def _with_untried(
    compared: list[Refit], new: Sequence[Explanation], refits: Refits, *, most: int | None = None
) -> list[Refit]:
    """The compared refits, with those of the untried among these explanations (at most `most`) added and
    compared with them."""
    untried = _each_once([each for each in new if not refits.tried(each)])[:most]
    return refits.compared([*(refit.explanation for refit in compared), *untried]) if untried else compared


def _each_once(several: Sequence[Explanation]) -> list[Explanation]:
    """These explanations, without those that name the same effects in another order."""
    return list({frozenset(each): each for each in several}.values())
