"""The diagnosis summarised in at most eight lines of plain text."""

from __future__ import annotations

from limbcli.diagnosis.explanations.conclusions import Diagnosis, NextStep
from limbcli.diagnosis.explanations.estimates import Estimates
from limbcli.diagnosis.explanations.forward_model import Explanation
from limbcli.numbers.significant_digits import short

_WORDS = {
    "adequate": "ADEQUATE: the model explains the measurement within its noise.",
    "named": "NAMED: one missing effect explains the misfit.",
    "ambiguous": "AMBIGUOUS: several explanations are possible, and these data cannot distinguish them.",
    "unexplained": "UNEXPLAINED: something is missing that no candidate, alone or with another, explains.",
    "untestable": "UNTESTABLE: no absolute test can be made of these data.",
}
_MOST_LISTED = 6  # explanations in a sentence
_LEAST_LISTED = 0.01  # probability of an effect from which a sentence mentions it
_LEAST_BITS = 0.1  # expected information from which a measurement is recommended


def in_words(explanation: Explanation) -> str:
    """
    >>> in_words(("tilt", "friction")), in_words(())
    ('tilt + friction', 'nothing')
    """
    return " + ".join(explanation) or "nothing"


def percent(probability: float) -> str:
    """
    >>> [percent(p) for p in (0.9999, 0.954, 0.003)]
    ['over 99 %', '95 %', 'under 1 %']
    """
    if probability > 0.99:
        return "over 99 %"
    return "under 1 %" if probability < 0.01 else f"{100 * probability:.0f} %"


def sentences(found: Diagnosis) -> list[str]:
    """Summary lines, at most eight, in the order of a reader's questions: verdict, fit, where and what,
    explanations, reduction of the residual, undetectable effects, next measurement, candidates not evaluated.
    """
    lines = [
        f"{_verdict(found)} Why: {found.reason}.",
        _fit(found),
        f"{_where(found)} {_what(found)}".strip(),
        _set(found),
        _shrunk(found),
        _blind(found),
        _next(found),
        _left(found),
    ]
    return [line for line in lines if line]


def _verdict(found: Diagnosis) -> str:
    two = found.verdict == "named" and len(found.chosen) > 1
    return "NAMED: two missing effects explain the misfit." if two else _WORDS[found.verdict]


def _fit(found: Diagnosis) -> str:
    base, values = found.shrink[0], found.base.values
    level = "of unknown level" if found.relative else "as stated"
    tissue = "Without any effect: c {c_kpa:.2f} kPa, m {m:.2f}; " if "c_kpa" in values else ""
    return f"{tissue.format(**values)}chi2 {base.chi2:.1f} on {base.nu} degrees of freedom, noise {level}."


def _where(found: Diagnosis) -> str:
    if found.check is None:
        return ""
    if not found.flagged:
        return "Where: no part of the data is significant by itself."
    tests = {each.name: each.p_adjusted for each in found.check.parts}
    listed = [f"{name} (adjusted p {tests[name]:.3g})" for name in found.flagged[:3]]
    return "Where: " + "; ".join(listed) + "."


def _what(found: Diagnosis) -> str:
    ranked = sorted(found.effects.items(), key=lambda item: -item[1])
    listed = ", ".join(f"{name} {percent(p)}" for name, p in ranked[:3] if p > _LEAST_LISTED)
    return f"Probability that it is missing, alone or with another: {listed}." if listed else ""


def _set(found: Diagnosis) -> str:
    if found.verdict in ("adequate", "untestable"):
        return ""
    shown = {each.explanation: each.probability for each in found.explanations}
    listed = "; ".join(
        f"{in_words(each)} {percent(shown[each])}" for each in found.confidence_set[:_MOST_LISTED]
    )
    more = len(found.confidence_set) - _MOST_LISTED
    rest = f"; {more} more, each less probable" if more > 0 else ""
    if found.verdict == "named":
        sizes = ", ".join(
            f"{name} {short(found.estimates.values[name])}" for name in found.final.effect_names
        )
        alone = f" With further effects: {listed}{rest}." if len(found.confidence_set) > 1 else ""
        return f"Added to the model: {in_words(found.chosen)} ({sizes}){_tissue(found.estimates)}.{alone}"
    if found.verdict == "ambiguous":
        return f"It may be: {listed}{rest}.{_common(found)}{_whichever(found.estimates)}"
    return f"Most probable, but not accepted: {listed}{rest}."


def _common(found: Diagnosis) -> str:
    first, *others = found.confidence_set
    shared = [name for name in first if all(name in each for each in others)]
    return f" All have {' and '.join(shared)}." if shared and others else ""


def _whichever(estimates: Estimates) -> str:
    """A sentence with c and m, averaged over the explanations.

    >>> _whichever(Estimates({}, {"c_kpa": (5.5, 8.5), "m": (1.0, 5.0)}, over=2))
    ' Averaged over these: c 5.50 to 8.50 kPa, m 1.00 to 5.00.'
    """
    if "c_kpa" not in estimates.intervals or "m" not in estimates.intervals:
        return ""
    return f" Averaged over these: c {_reach(estimates, 'c_kpa', ' kPa')}, m {_reach(estimates, 'm')}."


def _tissue(estimates: Estimates) -> str:
    """Values and intervals of c and m with the named effect, with sides that the data leave open.

    >>> values, open_ends = {"c_kpa": 6.0, "m": 3.5}, {"m": (True, False)}
    >>> _tissue(Estimates(values, {"c_kpa": (5.5, 6.5), "m": (1.0, 5.0)}, open_ends))
    '; then c 6.00 kPa (5.50 to 6.50), m 3.50 (up to 5.00: no lower limit from these data)'
    """
    if "c_kpa" not in estimates.intervals or "m" not in estimates.intervals:
        return ""
    c, m, values = _reach(estimates, "c_kpa"), _reach(estimates, "m"), estimates.values
    return f"; then c {values['c_kpa']:.2f} kPa ({c}), m {values['m']:.2f} ({m})"


def _reach(estimates: Estimates, name: str, unit: str = "") -> str:
    """An interval in words, with the sides that the data leave open.

    >>> _reach(Estimates({}, {"c_kpa": (0.4, 9.0)}, {"c_kpa": (True, True)}), "c_kpa")
    'not determined by the data'
    """
    low, high = estimates.intervals[name]
    below, above = estimates.open.get(name, (False, False))
    if below and above:
        return "not determined by the data"
    if below:
        return f"up to {high:.2f}{unit}: no lower limit from these data"
    if above:
        return f"from {low:.2f}{unit}: no upper limit from these data"
    return f"{low:.2f} to {high:.2f}{unit}"


def _shrunk(found: Diagnosis) -> str:
    if len(found.shrink) < 2:
        return ""
    first, last = found.shrink[0], found.shrink[-1]
    held = ""
    if len(first.held_out.keys() & last.held_out.keys()) > 1:  # at least one common block besides "all"
        before, after = first.held_out["all"], last.held_out["all"]
        held = f"; held-out error {before:.2f} to {after:.2f} deviations"
    words = in_words(last.explanation)
    return f"With {words}: chi2/nu from {first.chi2_per_nu:.2f} to {last.chi2_per_nu:.2f}{held}."


def _blind(found: Diagnosis) -> str:
    hidden = [spot for spot in found.blind_spots if spot.matters]
    if not found.blind_spots:
        return ""
    if not hidden:
        return (
            "No effect that was tried would, at plausible size, remain undetected and shift c or m by more "
            "than one standard deviation."
        )
    listed = []
    for spot in sorted(hidden, key=lambda s: -max(abs(v) for v in s.bias_sd.values()))[:3]:
        name, bias = max(spot.bias_sd.items(), key=lambda item: abs(item[1]))
        listed.append(
            f"{spot.name} (would shift {name} by {bias:+.1f} deviations, {spot.bias_percent[name]:+.0f} %)"
        )
    return "These data could not detect, at plausible size: " + "; ".join(listed) + "."


def _next(found: Diagnosis) -> str:
    if found.verdict != "ambiguous" or not found.next_steps:  # none: nothing was compared
        return ""
    best = recommended(found)
    if best is None:
        return "Next measurement: none of the available ones would distinguish the explanations."
    return (
        f"Next measurement: {best.sentence}; the probability of the true explanation is expected to rise "
        f"from {percent(best.before)} to {percent(best.expected_probability)}."
    )


def recommended(found: Diagnosis) -> NextStep | None:
    """The next measurement with the largest expected information, if worth recommending; else None."""
    best = found.next_steps[0] if found.next_steps else None
    return best if best is not None and best.information_bits > _LEAST_BITS else None


def _left(found: Diagnosis) -> str:
    parts = [f"{name} ({why})" for name, why in found.not_evaluated.items()]
    return "Not evaluated: " + "; ".join(parts) + "." if parts else ""
