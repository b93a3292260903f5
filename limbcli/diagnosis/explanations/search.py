"""Which explanations of a measurement to fit and to simulate: nothing, every effect, every pair of effects.

All effects are fitted on the surrogate. Pairs are ranked by their linear evidence, about the fit without
effects and about the fit of each effect that is likely; a pair that is likely is fitted as well. What is
fitted and likely is simulated, until no explanation with a probability above `UNSETTLED` rests on an
estimate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.forward_model import (
    Data,
    Direction,
    Explanation,
    Fitted,
    ForwardModel,
)
from limbcli.diagnosis.explanations.laplace import Posterior, posterior
from limbcli.diagnosis.explanations.linear_evidence import LinearEvidence
from limbcli.diagnosis.explanations.noise import correlated
from limbcli.errors import LimbError
from limbcli.model import Array
from limbcli.numbers.whitening import Whitener
from limbcli.progress import SILENT, Progress

# Error of an effect's own form, as no model of fat, fibres or a scar matches the limb exactly: a standard
# deviation that is a fraction of the change by the effect, correlated between neighbouring levels and, in
# images, over some millimetres, as edges are displaced. All sizes are assumed.
_SHARE, _ALIKE = 0.05, 0.8  # of the change of forces and mean speeds; correlation between neighbouring levels
_IN_IMAGE, _WIDE_MM, _ALIKE_IN_IMAGE = 0.15, 4.0, 0.97  # the same in an image, and its correlation length
_MOST_STEPS = 60  # fits and simulations of one search: far more than any needs


@dataclass(frozen=True, eq=False)
class Explained:
    """An explanation and its probability.

    posterior : None where the evidence is a linear estimate; simulated : the fit rests on simulations
    """

    explanation: Explanation
    probability: float
    ln_evidence: float
    posterior: Posterior | None
    simulated: bool = False


@dataclass(frozen=True)
class PriorOdds:
    """Prior probabilities of explanations by `n_effects` effects that can be evaluated."""

    n_effects: int
    something: float = decisions.SOMETHING_MISSING
    most_effects: int = 2

    def ln(self, explanation: Explanation) -> float:
        """
        >>> odds = PriorOdds(10)
        >>> [round(math.exp(odds.ln(each)), 4) for each in ((), ("a",), ("a", "b"))]
        [0.4494, 0.0449, 0.0022]
        """
        n, one = max(self.n_effects, 1), self.something
        weights = (1.0 - one, one / n, (one / n) ** 2 if self.most_effects > 1 else 0.0)
        total = sum(w * k for w, k in zip(weights, (1, self.n_effects, n * (n - 1) / 2), strict=True))
        return math.log(weights[len(explanation)] / total)

    @property
    def ln_single(self) -> float:
        """Of a single effect over nothing."""
        return self.ln(("any",)) - self.ln(())


def probabilities(ln_evidence: Mapping[Explanation, float], odds: PriorOdds) -> dict[Explanation, float]:
    """Probability of each explanation: its evidence times its prior, over the sum.

    >>> probabilities({(): 0.0, ("a",): 0.0}, PriorOdds(1, something=0.25, most_effects=1))
    {(): 0.75, ('a',): 0.25}
    """
    ln = np.array([value + odds.ln(each) for each, value in ln_evidence.items()])
    share = np.exp(ln - np.logaddexp.reduce(ln))
    return {each: float(p) for each, p in zip(ln_evidence, share, strict=True)}


def containing(explanation: Explanation, several: Sequence[Explained]) -> float:
    """Probability of all explanations that contain these effects.

    >>> several = [Explained(e, p, 0.0, None) for e, p in ((("a",), 0.6), (("a", "b"), 0.3), ((), 0.1))]
    >>> round(containing(("a",), several), 3)
    0.9
    """
    return sum(each.probability for each in several if set(explanation) <= set(each.explanation))


def credible(several: Sequence[Explained]) -> list[Explained]:
    """The smallest set with the probability `CREDIBLE`; several : the most probable first."""
    total, found = 0.0, []
    for each in several:
        found.append(each)
        total += each.probability
        if total >= decisions.CREDIBLE:
            break
    return found


def named(several: Sequence[Explained]) -> Explanation:
    """The most probable explanation that is likely itself and has, with those that contain it, the
    probability `CREDIBLE`; else none: of two effects that both show, neither is named alone."""
    for each in several:
        likely = each.probability > decisions.UNSETTLED
        if each.explanation and likely and containing(each.explanation, several) >= decisions.CREDIBLE:
            return each.explanation
    return ()


@dataclass(eq=False)
class Search:
    """Explanations of one data set.

    base : the fit without effects; relative : the noise level is estimated
    known : posteriors of what was fitted; settled : what needs no further fit or simulation
    linear : evidence of one effect more, about the fits of some explanations, that without effects first
    """

    forward_model: ForwardModel
    base: Fitted
    relative: bool
    most_effects: int = 2
    progress: Progress = SILENT
    known: dict[Explanation, Posterior] = field(default_factory=dict)
    settled: set[Explanation] = field(default_factory=set)
    simulated: set[Explanation] = field(default_factory=set)
    linear: dict[Explanation, LinearEvidence] = field(default_factory=dict)
    not_evaluated: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.facts = {each.name: each for each in self.forward_model.candidates}
        self.fitted(self.base)
        self.settled.add(())

    @property
    def data(self) -> Data:
        return self.forward_model.data

    @property
    def odds(self) -> PriorOdds:
        return PriorOdds(len(self.linear[()].added), most_effects=self.most_effects)

    def run(self) -> list[Explained]:
        """All explanations, the most probable first."""
        for name in self.linear[()].added:
            self._fit((name,))
        for _ in range(_MOST_STEPS):
            found = self.explained()
            if (open_ := self._next_open(found)) is not None:
                self._settle(open_)
                continue
            further = [
                (name,) for name in self.linear[()].added
                if (name,) in self.known and (name,) not in self.linear
                and containing((name,), found) > decisions.UNSETTLED
            ]  # fmt: skip
            if not further or self.most_effects < 2:
                break
            self.linearise(further[0])
        return self.explained()

    def _next_open(self, found: Sequence[Explained]) -> Explanation | None:
        """The next explanation to fit and simulate: of those that are likely, and before a pair its effects,
        as simulation can raise the evidence of either; None if all are settled."""
        for each in found:
            if each.probability <= decisions.UNSETTLED:
                break
            for one in (*((name,) for name in each.explanation), each.explanation):
                if one not in self.settled:
                    return one
        return None

    def fitted(self, fitted: Fitted) -> Posterior:
        found = self.known[fitted.explanation] = posterior(
            fitted, self.data.y, self.data.noise, self.forward_model.scalable,
            form=form_error(self.data, fitted), relative=self.relative,
        )  # fmt: skip
        return found

    def whitener(self, found: Posterior) -> Whitener:
        """Of the noise with the scalable errors and the form error of this explanation."""
        covariance = found.noise(self.data.noise).covariance
        form = form_error(self.data, found.fitted)
        return Whitener.of(found.level**2 * (covariance if form is None else covariance + form))

    def linearise(self, explanation: Explanation) -> None:
        """Linear evidence of one effect more about the fit of an explanation."""
        found = self.known[explanation]
        directions: dict[str, Sequence[Direction]] = {}
        for k, name in enumerate(self.facts):
            if name in explanation or (explanation and name not in self.linear[()].added):
                continue
            try:
                several = self.forward_model.directions(found.fitted, name)
            except LimbError as error:
                if not explanation:
                    self.not_evaluated[name] = error.what
            else:
                directions[name] = [each for each in several if np.any(each.columns)]
            if not explanation:
                self.progress.event("task", name="candidate " + name, done=k + 1, total=len(self.facts))
        self.linear[explanation] = LinearEvidence.about(
            found.fitted, self.data.y, self.whitener(found), directions
        )

    def explained(self) -> list[Explained]:
        """The explanations with what is known of them now."""
        ln_evidence = {each: found.ln_evidence for each, found in self.known.items()}
        names = list(self.linear[()].added)
        for name in names:  # whose fit failed
            if (name,) not in ln_evidence:
                ln_evidence[name,] = ln_evidence[()] + float(self.linear[()].ln_factor(name)[0])
        if self.most_effects > 1:
            for pair, value in self._of_pairs(names).items():
                ln_evidence.setdefault(pair, value)
        found = [
            Explained(each, p, ln_evidence[each], self.known.get(each), each in self.simulated)
            for each, p in probabilities(ln_evidence, self.odds).items()
        ]
        return sorted(found, key=lambda one: (-one.probability, len(one.explanation)))

    def _of_pairs(self, names: Sequence[str]) -> dict[Explanation, float]:
        """Linear estimates about the likelier linearised fit of a pair's effects, else about that without."""
        nothing = self.known[()].ln_evidence
        found: dict[Explanation, float] = {}
        for pair in itertools.combinations(names, 2):
            about = [
                self.known[(one,)].ln_evidence + float(self.linear[(one,)].ln_factor(other)[0])
                for one, other in (pair, pair[::-1])
                if (one,) in self.linear and other in self.linear[(one,)].added
            ]  # fmt: skip
            found[pair] = max(about) if about else nothing + self.linear[()].ln_factors_of_pairs[pair]
        return found

    def _fit(self, explanation: Explanation) -> Posterior | None:
        try:
            start = self.linear[()].start(explanation)
            found = self.fitted(self.forward_model.fit(explanation, start))
        except LimbError as error:
            self.not_evaluated[" + ".join(explanation)] = error.what
            self.settled.add(explanation)
            return None
        if not any(self.facts[name].simulated for name in explanation):
            self.settled.add(explanation)
        return found

    def _settle(self, explanation: Explanation) -> None:
        """Fit the explanation unless it is, and simulate the fit if it needs that."""
        found = self.known.get(explanation) or self._fit(explanation)
        if found is None or explanation in self.settled:
            self.settled.add(explanation)
            return
        label = " + ".join(explanation)
        self.progress.event("note", text=f"refit with {label}")
        self.settled.add(explanation)
        try:
            fitted = self.forward_model.verified(found.fitted)
        except LimbError as error:
            self.not_evaluated[label] = error.what
            return
        if fitted is None:
            return
        self.simulated.add(explanation)
        self.linear.pop(explanation, None)
        self.fitted(fitted)


def form_error(data: Data, fitted: Fitted) -> Array | None:
    """Covariance (n, n) of the error of the effects' own form; None if none of them is approximate."""
    if fitted.without is None:
        return None
    change = np.abs(fitted.prediction - fitted.without)
    total = np.zeros((len(data), len(data)))
    for mask in data.channels().values():
        own = np.where(mask, change, 0.0)
        if np.all(data.imaged[mask]):
            total += _in_image(data, _IN_IMAGE * own)
        else:
            total += correlated(
                "form", _SHARE * own, data.order, correlation=_ALIKE, source="assumed"
            ).covariance
    return total


def _in_image(data: Data, size: Array) -> Array:
    """Covariance (n, n) of errors with this standard deviation (n,) in one channel's images."""
    assert data.place is not None
    x, z = np.nan_to_num(data.place).T
    apart = np.hypot(np.subtract.outer(x, x), np.subtract.outer(z, z))
    alike = _ALIKE_IN_IMAGE ** np.abs(np.subtract.outer(data.order, data.order))
    return np.asarray(np.exp(-0.5 * (apart / _WIDE_MM) ** 2) * alike * np.outer(size, size))
