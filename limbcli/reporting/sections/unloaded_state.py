"""In which state is the tissue unloaded, and in which is it least stiff?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from limbcli.numbers.significant_digits import significant
from limbcli.reporting.agreement_view import agreement_view, sentence_of
from limbcli.reporting.fit_view import read_estimates
from limbcli.reporting.numbers import DASH, cell, quantity
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Cell, PageTable, Picture, Reportlet, pictures_of, table, worst_mood
from limbcli.reporting.sections.of_stage import of_stage
from limbcli.reporting.sections.parameters import estimates_table
from limbcli.results import StageResult

_WAYS = ("along", "around")


@of_stage(
    "fit-states", "fit-states", "In which state is the tissue least stiff, and in which is it unloaded?"
)
def states(result: StageResult, _: ReportData, site: SiteMaterial) -> Reportlet:
    """Speed at rest over stretch, the states' stretches and the common law."""
    data = result.data
    met = agreement_view(data)
    determined = not data.get("undetermined")
    return Reportlet(
        mood=worst_mood(met.mood, "fine" if determined and not result.warnings else "warning"),
        pictures=_pictures(result, site.name),
        tables=(_parameters(data), _states(data)),
        look_for="states on both sides of the lowest point, a curve through all of them, and one law "
        "that fits force and speed in each: then the stretch at which the tissue is unloaded is determined "
        "by the data",
        bad="states that lie on one slope of the curve: these data then do not determine where "
        "it is lowest, and a lowest point beyond the measured states rests on the law alone",
        notes=tuple(_notes(data)),
        warned=result.warnings,
        answer=met.sentence,
    )


def _pictures(result: StageResult, site: str) -> tuple[Picture, ...]:
    law = f"Shear-wave speed at rest over stretch: the states of site {site} and the law."
    curves = f"Force over depth and speed over force in each state of site {site}, with the fit."
    ends = "Profile likelihood over the law's parameters and the stretches."
    return pictures_of(
        result,
        {
            "states": (f"stretch-{site}", law),
            "picture": (f"states-{site}", curves),
            "profiles": (f"states-profiles-{site}", ends),
        },
    )


def _parameters(data: Mapping[str, Any]) -> PageTable:
    estimates = read_estimates(data.get("parameters", {}), data.get("element"))
    law = data.get("law_words") or data.get("law") or DASH
    return estimates_table(f"One law for all states: {law}; c is free", estimates)


def _states(data: Mapping[str, Any]) -> PageTable:
    rows = (
        (
            Cell(str(name), lead=True),
            *(_stretch(each.get(f"stretch_{way}") or {}) for way in _WAYS),
            cell(each.get("swe_at_rest_m_per_s")),
            cell(each.get("swe_at_rest_fitted_m_per_s")),
            cell(each.get("depth_rms_mm")),
        )
        for name, each in (data.get("states") or {}).items()
    )
    names = (
        "state", "stretch along", "stretch around", "SWE at rest [m/s]", "fitted [m/s]", "depth misfit [mm]",
    )  # fmt: skip
    return table("States, with their stretches over the unloaded tissue (95 %)", names, rows)


def _stretch(stretch: Mapping[str, Any]) -> Cell:
    value, low, high = stretch.get("value"), stretch.get("low"), stretch.get("high")
    if value is None:
        return Cell(DASH, reason="not in the result")
    if stretch.get("known"):
        return Cell(f"{significant(value)} (given)")
    if low is None and high is None:
        return Cell(DASH, reason="not determined by these data")
    ends = (DASH if each is None else significant(each) for each in (low, high))
    return Cell(f"{significant(value)} ({' to '.join(ends)})")


def _notes(data: Mapping[str, Any]) -> list[str]:
    least = data.get("least_stiffness") or {}
    notes = [sentence_of(str(each.get("words") or "")) for each in least.values()]
    for way, each in least.items():
        notes.append(_by_states(way, each.get("by_parabola_through_states") or {}))
    for way in _WAYS:
        found = (data.get("parameters") or {}).get(f"unloaded_stretch_{way}")
        if found is not None:
            notes.append(
                f"The tissue is unloaded {way} the limb at a stretch of {found.get('headline')}, on the "
                "scale of the case. This is not where the wave speed is lowest: the speed also depends on "
                "the direction of stretch."
            )
    for way, each in (data.get("taken_as_unloaded") or {}).items():
        notes.append(
            f"{way.capitalize()} the limb all states have the same stretch ({quantity(each, '')}); the "
            "tissue is taken as unloaded there."
        )
    notes.append(
        f"Fitted to the depths at the measured forces and the logarithms of all speeds, at rest and under "
        f"load: chi-square "
        f"{quantity(data.get('chi_square'), '')} for {data.get('n_freedom', DASH)} degrees of freedom."
    )
    return [each for each in notes if each]


def _by_states(way: str, found: Mapping[str, Any]) -> str:
    if found.get("stretch") is None and not found.get("told"):
        return f"The measured speeds alone show no upward curvature {way} the limb within their noise."
    if not found.get("told"):
        return (
            f"A parabola through the measured speeds alone has its minimum at {found['stretch']:.2f} {way} "
            "the limb, but its curvature is within the noise."
        )
    return (
        f"A parabola through the measured speeds alone has its minimum at {found['stretch']:.2f} {way} the "
        f"limb (95 %: {found['low']:.2f} to {found['high']:.2f})."
    )
