"""The diagnosis summarised in at most eight lines of plain text."""

from __future__ import annotations

from collections.abc import Sequence

from limbcli.diagnostics.conclusions.next_measurement import useful_steps
from limbcli.diagnostics.conclusions.verdict import Diagnosis
from limbcli.diagnostics.model.estimates import Reported
from limbcli.diagnostics.model.forward_model import Explanation
from limbcli.diagnostics.statistical_tests.multiple_testing import Family
from limbcli.significant_digits import short

_WORDS = {
    "adequate": "ADEQUATE: the model explains the measurement within its noise.",
    "named": "NAMED: one missing effect explains the misfit, and no other that could be tried does.",
    "ambiguous": "AMBIGUOUS: several explanations fit, and these data cannot distinguish them.",
    "unexplained": "UNEXPLAINED: something is missing that no candidate explains.",
    "untestable": "UNTESTABLE: no absolute test can be made of these data.",
}
_AND_MORE = (
    "NAMED: one missing effect explains the misfit; a further one may be present, which these data do not "
    "establish."
)
_ALONE = "AMBIGUOUS: one explanation fits, but the cause may be another, or more than this one."


def sentences(found: Diagnosis) -> list[str]:
    """Summary lines, at most eight, in the order of a reader's questions.

    Verdict, fit, where and what, explanations, reduction of the residual, undetectable effects, next
    measurement, candidates not evaluated.
    """
    lines = [
        f"{_verdict(found)} Why: {found.reason}.",
        _fit(found),
        f"{_where(found)} {_what(found)}".rstrip(),
        _set(found),
        _shrunk(found),
        _blind(found),
        _next(found),
        _left(found),
    ]
    return [line for line in lines if line]


def _verdict(found: Diagnosis) -> str:
    alone = len(found.confidence_set) == 1
    if found.verdict == "ambiguous" and alone:
        return _ALONE
    text = _AND_MORE if found.verdict == "named" and not alone else _WORDS[found.verdict]
    several = len(found.chosen) > 1
    return text.replace("one missing effect explains", "two missing effects explain") if several else text


def _fit(found: Diagnosis) -> str:
    base = found.shrink[0] if found.shrink else None
    if base is None:
        return ""
    values = base.estimates.values
    level = "of unknown level" if found.relative else "as stated"
    text = (
        f"Without any effect: c {values['c_kpa']:.2f} kPa, m {values['m']:.2f}; " if "c_kpa" in values else ""
    )
    return f"{text}chi2 {base.chi2:.1f} on {base.nu} degrees of freedom, noise {level}."


def _where(found: Diagnosis) -> str:
    if not found.family.tests:
        return ""
    if not found.flagged:
        return "Where: no part of the data is significant by itself."
    tests = {t.name.removeprefix("where: "): t.p_adjusted for t in found.family.tests}
    listed = [f"{name} (adjusted p {tests[name]:.3g})" for name in found.flagged[:3]]
    return "Where: " + "; ".join(listed) + "."


def _what(found: Diagnosis) -> str:
    ranked = ranking(found.family, set(found.facts))
    listed = [f"{name} ({p:.3g})" for name, p in ranked[:3]]
    return "Best candidates (adjusted p): " + ", ".join(listed) + "." if listed else ""


def ranking(family: Family, names: set[str]) -> list[tuple[str, float]]:
    """Candidates sorted by adjusted p, then by decreasing score statistic."""
    tests = [t for t in family.tests if t.name in names]
    tests.sort(key=lambda t: (t.p_adjusted, -t.score.statistic))
    return [(t.name, t.p_adjusted) for t in tests]


def _set(found: Diagnosis) -> str:
    if not found.confidence_set:
        return ""
    listed = "; ".join(" + ".join(each) for each in found.confidence_set)
    if found.verdict == "named":
        estimates = found.estimates
        sizes = ", ".join(f"{name} {short(estimates.values[name])}" for name in found.final.effect_names)
        others = [" + ".join(each) for each in found.confidence_set if each != found.chosen]
        over = "; the intervals of c and m cover all of these" if estimates.over > 1 else ""
        more = f" Also fits: {'; '.join(others)}{over}." if others else ""
        return f"Added to the model: {' + '.join(found.chosen)} ({sizes}){_tissue(estimates)}.{more}"
    if found.verdict == "ambiguous":
        return f"It may be: {listed}.{_common(found.confidence_set)}{_whichever(found.estimates)}"
    return f"Fits, but is not accepted: {listed}."


def _common(several: Sequence[Explanation]) -> str:
    """A sentence with the effects that all explanations share; empty if there are none.

    >>> _common([("tilt", "skin-layer"), ("skin-layer", "friction")])
    ' All have skin-layer.'
    >>> _common([("tilt",), ("skin-layer",)]) + _common([("tilt",)])
    ''
    """
    shared = [name for name in several[0] if all(name in each for each in several)]
    return f" All have {' and '.join(shared)}." if shared and len(several) > 1 else ""


def _whichever(estimates: Reported) -> str:
    """A sentence with the intervals of c and m over all explanations that fit.

    >>> _whichever(Reported({}, {}, {"c_kpa": (5.5, 8.5), "m": (1.0, 5.0)}, over=2))
    ' Whichever of the 2 it is: c 5.50 to 8.50 kPa, m 1.00 to 5.00.'
    """
    ends = estimates.intervals
    if estimates.over < 2 or "c_kpa" not in ends or "m" not in ends:
        return ""
    c, m = _reach(estimates, "c", "c_kpa", " kPa"), _reach(estimates, "m", "m")
    return f" Whichever of the {estimates.over} it is: c {c}, m {m}."


def _tissue(estimates: Reported) -> str:
    """Values and intervals of c and m with the named effect, with sides that the data leave open.

    >>> _tissue(Reported({"c_kpa": 6.0, "m": 3.5}, {}, {"c_kpa": (5.5, 6.5), "m": (1.0, 5.0)}, ("m below",)))
    '; then c 6.00 kPa (5.50 to 6.50), m 3.50 (up to 5.00: no lower limit from these data)'
    """
    if "c_kpa" not in estimates.intervals or "m" not in estimates.intervals:
        return ""
    c, m = _reach(estimates, "c", "c_kpa"), _reach(estimates, "m", "m")
    values = estimates.values
    return f"; then c {values['c_kpa']:.2f} kPa ({c}), m {values['m']:.2f} ({m})"


def _reach(estimates: Reported, symbol: str, name: str, unit: str = "") -> str:
    """An interval in words, with the sides that the data leave open.

    >>> _reach(Reported({}, {}, {"c_kpa": (0.4, 9.0)}, ("c below", "c above")), "c", "c_kpa")
    'not determined by the data'
    """
    low, high = estimates.intervals[name]
    below, above = f"{symbol} below" in estimates.open, f"{symbol} above" in estimates.open
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
    placebo = (
        ""
        if last.placebo_percentile is None
        else f"; better than {last.placebo_percentile:.0f} % of placebos"
    )
    return (
        f"With {' + '.join(last.explanation)}: chi2/nu from {first.chi2_per_nu:.2f} to "
        f"{last.chi2_per_nu:.2f}{held}{placebo}."
    )


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
    useful = useful_steps(found.next_steps)
    if not useful:
        return "Next measurement: none of the available ones would distinguish the explanations."
    best_pair, worst = useful[0], useful[-1]
    text = (
        f"Next measurement: {best_pair.sentence}; it distinguishes {best_pair.pair[0]} from "
        f"{best_pair.pair[1]} with "
        f"{100 * best_pair.power:.0f} % power"
    )
    if worst.pair != best_pair.pair:
        text += f", {worst.pair[0]} from {worst.pair[1]} with {100 * worst.power:.0f} %"
    return text + "."


def _left(found: Diagnosis) -> str:
    parts = [f"{name} ({why})" for name, why in found.not_evaluated.items()]
    return "Not evaluated: " + "; ".join(parts) + "." if parts else ""
