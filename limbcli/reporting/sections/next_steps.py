"""Warnings at the top of a page, and what to measure next at a site."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from limbcli.reporting.fit_view import FitView
from limbcli.reporting.numbers import number
from limbcli.reporting.outcome import command_of
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.sections.model_checks import model_check_words


def next_steps(page: ReportData, site: SiteMaterial, view: FitView) -> tuple[str, ...]:
    """Sentences, the most informative first; empty if nothing is left to measure."""
    steps = []
    diagnosed = page.outcomes.usable("diagnose", site.name)
    found = None if diagnosed is None else diagnosed.data
    if view.force.state == "bad":
        steps.append(
            "Check the units, signs and zeros of force and depth, then repeat the measurement: no "
            "curve of the law fits these levels."
        )
    elif view.whole.state == "bad":
        is_named = found is not None and found.get("verdict") == "named"
        steps.append(
            "The law fitted to the force does not predict the shear-wave speeds under load: "
            + ("use c and m of the diagnosis, whose model has what was missing, not of this fit."
               if is_named
               else "do not use c and m together before the diagnosis has named what is missing.")
        )  # fmt: skip
    elif view.force.too_close:
        steps.append(
            "Give the levels as they were read, not smoothed, and state the noise that repeated levels show "
            "([site.noise]): the curve lies closer to them than the stated noise allows."
        )
    if found is not None:
        steps += _proposed(found.get("next_measurement"))
    else:
        command = command_of("diagnose", site.name, out=page.out, case_name=page.case_name)
        steps.append(f"Run the diagnosis to see which measurement would be most informative: {command}")
    if view.noise_source == "assumed":
        steps.append(
            "Repeat one level three times or more and state its standard deviation in [site.noise] "
            "with source = “repeats”: all intervals rest on an assumed noise."
        )
    steps += _of_the_parameters(site, view)
    if view.c_is_given:
        steps.append(
            "Measure the shear-wave speed at 0 N: c was entered by hand, and all results scale with it."
        )
    return tuple(steps)


def _proposed(found: object) -> list[str]:
    """The diagnosis's own proposal, with the probability that it decides between the explanations."""
    if not isinstance(found, Mapping) or not found.get("recommended"):
        return []
    menu = found.get("menu") or []
    own = [each for each in menu if isinstance(each, Mapping) and each.get("name") == found["recommended"]]
    sentence = str(own[0].get("sentence") or found["recommended"]) if own else str(found["recommended"])
    expected = number(found.get("expected_probability"))
    chance = (
        ""
        if expected is None
        else f" (the true explanation then has a probability of {100 * expected:.0f} % on average)"
    )
    return [f"{sentence[0].upper()}{sentence[1:]}{chance}."]


def _of_the_parameters(site: SiteMaterial, view: FitView) -> list[str]:
    step: Any = view.last
    m = step.estimate("m") if step else None
    if m is None or m.is_sound:
        return []
    depth = site.measured.depth.max() if site.measured is not None and len(site.measured.depth) else None
    reached = f" than the {depth:.1f} mm reached" if depth is not None else ""
    return [
        f"Press deeper{reached}, as far as tolerated: m shows at large strains, and is {m.headline} here."
    ]


class WarningKind(StrEnum):
    """What a warning of a kind can change; the first matters most."""

    PAGE = "Whether these results belong together"
    LEVELS = "Measured force, depth and speed, and with them every parameter"
    PARAMETERS = "Parameters and their intervals"
    MODEL = "Simulated force (geometry, mesh, contact)"
    LIMB = "Whole limb, and the pressure in its socket; no parameter of the fit"
    DIAGNOSIS = "Diagnosis only; no parameter of the fit"


# by stage; warnings of the other stages are of the model
_OF_STAGES = {
    "limb": WarningKind.LIMB,
    "socket": WarningKind.LIMB,
    "diagnose": WarningKind.DIAGNOSIS,
} | dict.fromkeys(("fit", "fit-joint", "fit-states", "fit-elements"), WarningKind.PARAMETERS)
_FEW = 4  # so many are shown without folding those that change no parameter directly


@dataclass(frozen=True)
class SourcedWarning:
    """A warning, its source in words (a stage with its site, "levels p1"), and what it can change."""

    source: str
    text: str
    changes: WarningKind


def changes_of(stage: str) -> WarningKind:
    """What a warning of a stage can change."""
    return _OF_STAGES.get(stage, WarningKind.MODEL)


@dataclass(frozen=True)
class WarningGroup:
    """Warnings that can change the same thing.

    size : how much, in units of the result, if that was computed; else ""
    folded : whether the page shows them only on demand
    """

    changes: WarningKind
    size: str
    warnings: tuple[SourcedWarning, ...]
    folded: bool


def warning_groups(warnings: Sequence[SourcedWarning], page: ReportData) -> tuple[WarningGroup, ...]:
    """The groups that are not empty, the most important first."""
    groups = []
    for kind in WarningKind:
        own = tuple(each for each in warnings if each.changes == kind)
        folded = kind in (WarningKind.MODEL, WarningKind.LIMB, WarningKind.DIAGNOSIS) and len(warnings) > _FEW
        if own:
            groups.append(WarningGroup(kind, _size(page) if kind == WarningKind.MODEL else "", own, folded))
    return tuple(groups)


def _size(page: ReportData) -> str:
    """What the fits found when they changed their models, in percent of the force."""
    results = [(site.name, page.outcomes.of("fit", site.name).usable) for site in page.sites]
    found = [(name, model_check_words(result.data)) for name, result in results if result is not None]
    told = [f"{name}: {words}" if len(page.sites) > 1 else words for name, words in found if words]
    return "; ".join(told)
