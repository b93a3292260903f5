"""The warnings of a page: each once, ranked by what it can change, with its size where that is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from limbcli.reporting.report_data import ReportData
from limbcli.reporting.sections.model_checks import model_check_words


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
