"""What, if anything, is missing in the model?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.numbers.significant_digits import short
from limbcli.reporting.fit_view import FitView, read_fit_view
from limbcli.reporting.numbers import DASH, quantity
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Mood, PageTable, Reportlet, pictures_of, table
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.results import UNLIKE_OURS, StageResult

_MOODS: Mapping[str, Mood] = {"adequate": "fine", "named": "warning"}


@of_stage("diagnose", "diagnosis", "What is missing in the model, if anything?")
def diagnosis(result: StageResult, page: ReportData, site: SiteMaterial) -> Reportlet:
    """Verdict, gap before and after, candidates and undetectable effects."""
    data, fit = result.data, page.outcomes.usable("fit", site.name)
    first, *others = data["sentences"]
    return Reportlet(
        mood=_MOODS.get(data["verdict"], "warning"),
        pictures=pictures_of(
            result, {k: (f"diagnosis-{k}-{site.name}", words) for k, words in _PICTURES.items()}
        ),
        tables=(_candidates(data),),
        more=(_explanations(data), _shrunk(data), _blind(data), *_sizes(data), *_common(data)),
        look_for="residuals of the base model (grey) that leave the band of two standard deviations, "
        "and that the model with the addition (blue) brings back into it",
        bad="one name where the verdict is ambiguous, a misfit that remains, or a candidate right of "
        "the dashed line in the lower panel: these data cannot detect it",
        notes=(*others, *_against_the_fit(data, read_fit_view(fit) if fit else None)),
        warned=result.warnings,
        answer=first,
    )


def _against_the_fit(data: Mapping[str, Any], fit: FitView | None) -> tuple[str, ...]:
    """Why c and m of the diagnosis without any effect are not those of the fit."""
    base, step = data["shrink"][0], fit.last if fit else None
    m = step.estimate("m") if step else None
    if step is None or m is None or "m" not in base["open_ends"]:
        return ()
    channels = ", ".join(base["rms"])
    return (
        f"Without any effect, the diagnosis finds c {_interval(base, 'c_kpa')} kPa and "
        f"m {_interval(base, 'm')}; the fit holds c at {quantity(step.c_kpa, 'kPa')} and finds "
        f"m: {m.headline}. The fit follows the force alone, all levels alike; the diagnosis fits c and m "
        f"to all channels ({channels}), each weighted by its noise, with a prior for m.",
    )


def in_short(page: ReportData, site: SiteMaterial) -> str | None:
    """One line: what is missing, and the gap before and after; None without a result of `diagnose`."""
    result = page.outcomes.usable("diagnose", site.name)
    try:
        return None if result is None else in_words(result.data)
    except UNLIKE_OURS:
        return None


def in_words(data: Mapping[str, Any]) -> str:
    """
    >>> gap = [{"chi2_per_nu": 1.472}, {"chi2_per_nu": 0.92}]
    >>> in_words({"verdict": "named", "added": ["tilt"], "shrink": gap})
    'tilt (named); the misfit (chi2/nu, with the error of the model counted) went from 1.47 to 0.92'
    >>> open_set = {"verdict": "ambiguous", "confidence_set": [["tilt"], ["skin", "preload"]]}
    >>> in_words({**open_set, "added": ["tilt"], "shrink": gap}).partition(" (chi2")[0]
    'ambiguous: 2 explanations fit alike; with the most probable, the misfit'
    >>> in_words({"verdict": "adequate", "added": [], "shrink": gap[:1]})
    'adequate'
    """
    added, shrink = data["added"], data["shrink"]
    if not added or len(shrink) < 2:
        return str(data["verdict"])
    first = f"{' and '.join(added)} ({data['verdict']}); "
    if data["verdict"] == "ambiguous":  # no member of the set stands for it, and the picture draws them grey
        n = len(data["confidence_set"])
        first = f"ambiguous: {n if n > 1 else 'several'} explanations fit alike; with the most probable, "
    before, after = (each["chi2_per_nu"] for each in (shrink[0], shrink[-1]))
    went = f"went from {before:.2f} to {after:.2f}"
    return f"{first}the misfit (chi2/nu, with the error of the model counted) {went}"


_PICTURES = {
    "gap": "Measured minus predicted in deviations, before and after",
    "candidates": "Probability and detectable size of every candidate",
    "sizes": "Size of each effect, in units of its plausible size (95 %)",
}


def _candidates(data: Mapping[str, Any]) -> PageTable:
    rows = []
    for each in data["candidates"]:
        size = ", ".join(f"{name} {short(value)}" for name, value in each["estimate"].items())
        rows.append((each["name"], each["sentence"], f"{each['probability']:.3f}", size or DASH))
    rows += [(name, f"not evaluated: {why}", DASH, DASH) for name, why in data["not_evaluated"].items()]
    titles = ("candidate", "interpretation", "probability", "estimate when it alone is added")
    return table("Candidates, the most probable first", titles, rows, numeric=False)


def _explanations(data: Mapping[str, Any]) -> PageTable:
    rows = []
    for each in data["explanations"][: len(data["confidence_set"])]:
        values = each["values"]
        rows.append((
            " + ".join(each["explanation"]) or "nothing is missing", f"{each['probability']:.3f}",
            *(f"{values[name]:.2f}" if name in values else DASH for name in ("c_kpa", "m")),
            "simulated" if each["simulated"] else "fitted" if each["fitted"] else "estimated",
        ))  # fmt: skip
    titles = ("explanation", "probability", "c (kPa)", "m", "by")
    return table("Explanations that together have 95 %", titles, rows)


def _shrunk(data: Mapping[str, Any]) -> PageTable:
    rows = []
    for stage in data["shrink"]:
        held = stage["held_out"].get("all")
        label = " + ".join(stage["explanation"]) or "base model"
        if stage["c_and_m_over"] > 1:
            label += f" (c, m: averaged over {stage['c_and_m_over']} explanations)"
        rows.append((
            label, f"{stage['chi2_per_nu']:.2f}", DASH if held is None else f"{held:.2f}",
            _interval(stage, "c_kpa"), _interval(stage, "m"),
        ))  # fmt: skip
    titles = ("model", "chi2/nu", "held-out error (deviations)", "c (kPa), 95 %", "m, 95 %")
    return table("How the misfit decreased", titles, rows)


def _interval(stage: Mapping[str, Any], name: str) -> str:
    """Value and interval, without ends that the data leave open; a dash for what was not fitted.

    >>> stage = {"values": {"m": 3.9}, "intervals_95": {"m": [1.0, 6.2]}, "open_ends": {"m": [False, False]}}
    >>> _interval(stage, "m"), _interval({**stage, "open_ends": {"m": [True, False]}}, "m")
    ('3.90 (1.00 to 6.20)', '3.90 (up to 6.20)')
    """
    if name not in stage["open_ends"]:
        return DASH
    (low, high), (below, above) = stage["intervals_95"][name], stage["open_ends"][name]
    reach = f"{low:.2f} to {high:.2f}"
    if below or above:
        reach = "open" if below and above else f"up to {high:.2f}" if below else f"from {low:.2f}"
    return f"{stage['values'][name]:.2f} ({reach})"


def _blind(data: Mapping[str, Any]) -> PageTable:
    rows = []
    for spot in data["blind_spots"]:
        size = spot["detectable_times_typical"]
        bias = ", ".join(f"{name} {value:+.1f}" for name, value in spot["bias_sd"].items())
        shown = DASH if size is None else short(size)
        rows.append((spot["name"], f"{spot['visible_fraction']:.2f}", shown, bias))
    titles = (
        "effect", "visible share", "detectable size (plausible sizes)", "bias if undetected (deviations)",
    )  # fmt: skip
    return table("What these data can detect", titles, rows)


def _sizes(data: Mapping[str, Any]) -> tuple[PageTable, ...]:
    """Possible size of each effect if it alone is added; empty if none has a size."""
    rows = [
        (effect, name, *("open" if end is None else short(end) for end in ends))
        for effect, sizes in data["sizes_95"].items() for name, ends in sizes.items()
    ]  # fmt: skip
    titles = ("effect", "size", "from", "to (95 %)")
    return (table("Size of each effect when it alone is added", titles, rows),) if rows else ()


def _common(data: Mapping[str, Any]) -> tuple[PageTable, ...]:
    """Estimates of the errors that many readings have in common; empty if there are none."""
    rows = [
        (each["name"].removeprefix("model: "), f"{each['value']:+z.1f}", f"{each['deviation']:.1f}")
        for each in data["common_errors"]
    ]
    titles = ("error", "estimate (prior deviations)", "left of the prior's deviation")
    return (table("Errors of model and instruments, fitted with their priors", titles, rows),) if rows else ()
