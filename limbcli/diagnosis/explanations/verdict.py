"""The complete diagnosis of one data set with one forward model: the probability of every explanation.

The model is adequate if "nothing" is as probable as it is in 95 % of the measurements with nothing missing,
which draws from the noise show. Else the effects that every likely explanation has are named if together
these have 95 %, a simulation at their fit confirms it, none of their sizes may be none or ends on the limit
of what there can be, and they describe every part of the data; if not, the set of explanations with 95 % is
reported. If even the most probable one fails the posterior predictive check, the verdict is unexplained.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.conclusions import (
    BlindSpot,
    Diagnosis,
    NextStep,
    Shrink,
    Word,
    blind_spot,
    ranked,
)
from limbcli.diagnosis.explanations.estimates import Estimates, estimates, sizes_95
from limbcli.diagnosis.explanations.forward_model import Explanation, ForwardModel
from limbcli.diagnosis.explanations.laplace import Posterior
from limbcli.diagnosis.explanations.linear_evidence import LinearEvidence, least_by_chance
from limbcli.diagnosis.explanations.noise import CommonError, common_errors
from limbcli.diagnosis.explanations.residuals import (
    Check,
    Roughness,
    checked,
    held_out_error,
    over_shared,
    roughness,
)
from limbcli.diagnosis.explanations.search import Explained, Search, containing, credible, named
from limbcli.errors import LimbError
from limbcli.progress import SILENT, Progress

_MOST_COMPARED = 6  # explanations compared in choosing the next measurement


def diagnose(
    forward_model: ForwardModel, *, max_effects: int = 2, seed: int = 7, propose: bool = True,
    progress: Progress = SILENT,
) -> Diagnosis:  # fmt: skip
    """Diagnose one forward model. Deterministic for a given seed. Raises LimbError if the base model itself
    cannot be fitted."""
    return Conclusion.of(
        forward_model, max_effects=max_effects, seed=seed, propose=propose, progress=progress
    ).diagnosis()


@dataclass(frozen=True, eq=False, kw_only=True)
class Conclusion:
    """What an ended search says.

    several : the explanations, the most probable first; limit : probability of "nothing" from which the model
        is adequate
    determined : there are more data than parameters of the fit without effects
    """

    search: Search
    several: Sequence[Explained]
    limit: float
    rough: Roughness | None
    determined: bool
    seed: int
    propose: bool
    _checks: dict[Explanation, Check] = field(default_factory=dict)

    @staticmethod
    def of(
        forward_model: ForwardModel, *, max_effects: int, seed: int, propose: bool, progress: Progress
    ) -> Conclusion:
        data, base = forward_model.data, forward_model.fit((), {})
        whiten = data.noise.whitener
        state = base.whitened(data.y, whiten)
        rough = roughness(state, whiten, series=data.all_series(), order=data.order)
        contradicted = rough is not None and rough.p < decisions.ROUGH_P
        search = Search(forward_model, base, data.noise.is_assumed or contradicted, max_effects, progress)
        if state.nu >= 1:
            search.linearise(())
        else:
            search.linear[()] = LinearEvidence(state.residual, {})
        limit = least_by_chance(search.linear[()], search.odds.ln_single, np.random.default_rng([seed, 1]))
        return Conclusion(
            search=search, several=search.run(), limit=limit, rough=rough, determined=state.nu >= 1,
            seed=seed, propose=propose,
        )  # fmt: skip

    def diagnosis(self) -> Diagnosis:
        if not self.determined:
            return self._finish("untestable", "there are no more data than fitted parameters", ())
        best = self.several[0]
        relative = self.search.relative
        if best.posterior is not None and self._left_of(best).p < decisions.CHECKED and not relative:
            words = " + ".join(best.explanation) or "nothing missing"
            why = f"even the most probable explanation ({words}) leaves a residual beyond the noise"
            return self._finish("unexplained", why, ())
        if self.nothing >= self.limit:
            if not relative:
                return self._finish("adequate", "no effect is more probable than chance allows", ())
            why = (
                "the noise is assumed: the fit cannot be judged in absolute terms"
                if self.search.data.noise.is_assumed
                else "the data scatter more than their stated noise"
            )
            return self._finish("untestable", f"{why}, and no effect is more probable than chance allows", ())
        chosen = named(self.several)
        if chosen:
            p = containing(chosen, self.several)
            alone = f"{' + '.join(chosen)} has a probability of {100 * p:.0f} %"
            if chosen not in self.search.known:
                return self._finish("ambiguous", f"{alone} to first order, but its fit failed", ())
            if not self._confirmed(chosen):
                return self._finish("ambiguous", f"{alone}, but no simulation could confirm it", ())
            if absent := self._of_any_size(chosen):
                why = f"{alone}, but the size of {' and of '.join(absent)} may as well be none"
                return self._finish("ambiguous", why, ())
            if limits := self._on_limits(chosen):
                why = f"{alone}, but the data ask for more of it than there can be ({'; '.join(limits)})"
                return self._finish("ambiguous", why, ())
            left = () if relative else self._checked(self.search.known[chosen]).flagged
            if left:
                return self._finish("ambiguous", f"{alone}, but does not describe {' and '.join(left)}", ())
            return self._finish("named", alone, chosen)
        n = len(credible(self.several))
        why = f"{n} explanations together have a probability of {100 * decisions.CREDIBLE:.0f} %"
        return self._finish("ambiguous", why, ())

    def _confirmed(self, chosen: Explanation) -> bool:
        """Whether a simulation that needs to be was made of these effects at their fit: extrapolated far, an
        effect can seem to describe anything."""
        if not any(self.search.facts[name].simulated for name in chosen):
            return True
        return any(set(chosen) <= set(each) for each in self.search.simulated)

    def _of_any_size(self, chosen: Explanation) -> list[str]:
        """Effects whose sizes all have their null value in their 95 % intervals. They may be probable all the
        same where the models err in few of many data, as beside bone in maps."""
        intervals = self._averaged(self.search.known[chosen]).intervals
        found = []
        for name in chosen:
            priors = self.search.linear[()].best(name).direction.priors
            sizes = [(prior.mean, *intervals[size]) for size, prior in priors.items()]
            if sizes and all(low <= null <= high for null, low, high in sizes):
                found.append(name)
        return found

    def _on_limits(self, chosen: Explanation) -> list[str]:
        """Sizes that the fit ends on the limit of: errors of the models look like an effect of any size."""
        at_bound = self.search.known[chosen].fitted.at_bound
        sizes = [self.search.linear[()].best(name).direction.priors for name in chosen]
        return [at_bound[size] for each in sizes for size in each if size in at_bound]

    @property
    def nothing(self) -> float:
        """Probability of "nothing" against all single effects."""
        ln = {
            each.explanation: each.ln_evidence + self.search.odds.ln(each.explanation)
            for each in self.several if len(each.explanation) < 2
        }  # fmt: skip
        return float(np.exp(ln[()] - np.logaddexp.reduce(list(ln.values()))))

    def _left_of(self, each: Explained) -> Check:
        """Check of an explanation, or of the larger of its parts that was fitted."""
        known = [found for e, found in self.search.known.items() if set(e) <= set(each.explanation)]
        return self._checked(max(known, key=lambda one: (len(one.fitted.explanation), one.ln_evidence)))

    def _checked(self, found: Posterior) -> Check:
        key = found.fitted.explanation
        if key not in self._checks:
            whiten = self.search.whitener(found)
            state = found.fitted.whitened(self.search.data.y, whiten, as_it_stands=True)
            rng = np.random.default_rng([self.seed, 2])
            self._checks[key] = checked(self.search.data, state, whiten, rng)
        return self._checks[key]

    # ------------------------------------------------------------ what is reported

    def _finish(self, word: Word, reason: str, chosen: Explanation) -> Diagnosis:
        search, best = self.search, self.several[0]
        members = credible(self.several)
        names = search.linear[()].added
        testable = word != "untestable" or bool(names)
        shown = chosen or (best.explanation if word in ("unexplained", "ambiguous") else ())
        base = search.known[()]
        return Diagnosis(
            verdict=word, reason=reason, relative=search.relative, base=base.fitted,
            nothing=self.nothing, adequate_from=self.limit,
            explanations=tuple(self.several), confidence_set=tuple(each.explanation for each in members),
            effects={name: containing((name,), self.several) for name in names}, chosen=chosen,
            check=self._checked(base) if testable else None,
            left=self._left_of(best) if testable else None, shrink=self._shrink(shown),
            blind_spots=self._blind_spots(), next_steps=self._next_steps(members) if self.propose else (),
            not_evaluated=search.not_evaluated, roughness=self.rough, facts=search.facts, seed=self.seed,
            sizes=sizes_95(search.known, search.linear[()]),
            common_errors={
                each.explanation: self._common(each.posterior) for each in self.several if each.posterior
            },
        )  # fmt: skip

    def _shrink(self, shown: Explanation) -> tuple[Shrink, ...]:
        """Stages from the base model to the shown explanation, with its effects added one at a time; the last
        one's c and m are averaged over all explanations."""
        known, data = self.search.known, self.search.data
        while shown not in known:
            shown = shown[:-1]
        stages = [known[shown[:n]] for n in range(len(shown) + 1) if shown[:n] in known]
        held_out = over_shared([held_out_error(data, each.fitted) for each in stages], data.blocks)
        alone = (estimates([(1.0, each)], imaged=bool(data.imaged.any())) for each in stages[:-1])
        values = [*alone, self._averaged(stages[-1])]
        whiten, found = data.noise.whitener, []
        for each, held, own in zip(stages, held_out, values, strict=True):
            state = each.fitted.whitened(data.y, whiten, as_it_stands=True)
            z = (data.y - each.fitted.prediction) / data.deviation
            rms = {name: float(np.sqrt(np.mean(z[mask] ** 2))) for name, mask in data.channels().items()}
            one = each.fitted.explanation
            found.append(Shrink(one, chi2=state.chi2, nu=state.nu, rms=rms, held_out=held, estimates=own))
        return tuple(found)

    def _averaged(self, mine: Posterior) -> Estimates:
        imaged = bool(self.search.data.imaged.any())
        fits = [(each.probability, each.posterior) for each in self.several if each.posterior is not None]
        others = [(p, one) for p, one in fits if one is not mine and p > 1e-3]
        own = next(p for p, one in fits if one is mine)
        return estimates([(max(own, 1e-6), mine), *others], imaged=imaged)

    def _common(self, found: Posterior) -> tuple[CommonError, ...]:
        whiten, data = self.search.whitener(found), self.search.data
        return common_errors(data.noise, whiten, found.fitted.whitened(data.y, whiten))

    def _blind_spots(self) -> tuple[BlindSpot, ...]:
        """Detectability of every candidate at its typical size, the least detectable first."""
        nothing, linear = self.search.known[()], self.search.linear[()]
        whiten, found = self.search.whitener(nothing), []
        odds = (1.0 - self.limit) / max(self.limit, 1e-12)
        needed = math.log(max(odds, 1e-12)) - self.search.odds.ln_single if linear.added else 0.0
        for name in linear.added:
            added, plausible = linear.best(name), self.search.facts[name].typical
            typical = np.array([plausible.get(size, 0.0) for size in added.direction.priors])
            if np.any(typical):
                found.append(blind_spot(name, added, typical, nothing, whiten, ln_factor=needed))
        return tuple(sorted(found, key=lambda spot: -spot.detectable_times_typical))

    def _next_steps(self, members: Sequence[Explained]) -> tuple[NextStep, ...]:
        """Measurements that would tell the likely explanations apart."""
        fits = [each for each in members if each.posterior is not None][:_MOST_COMPARED]
        if len(fits) < 2:
            return ()
        try:
            proposals = self.search.forward_model.proposals(
                [each.posterior.fitted for each in fits if each.posterior]
            )
        except LimbError as error:
            self.search.not_evaluated["next measurement"] = error.what
            return ()
        return ranked(fits, proposals, np.random.default_rng([self.seed, 3]))
