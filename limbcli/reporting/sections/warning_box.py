"""The warnings of a page: each once, ranked by what it can change, with its size where that is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from limbcli.reporting.outcome import EXTRA_SITE_STAGES, EXTRA_SUBJECT_STAGES
from limbcli.reporting.report_data import ReportData
from limbcli.reporting.sections.model_checks import model_check_words

PAGE, LEVELS, PARAMETERS, MODEL, LIMB, DIAGNOSIS = (
    "report", "levels", "parameters", "model", "limb", "diagnose",
)  # fmt: skip
# What a warning of a kind can change; the first matters most.
CHANGES: Mapping[str, str] = {
    PAGE: "Whether these results belong together",
    LEVELS: "Measured force, depth and speed, and with them every parameter",
    PARAMETERS: "Parameters and their intervals",
    MODEL: "Simulated force (geometry, mesh, contact)",
    LIMB: "Whole limb, and the pressure in its socket; no parameter of the fit",
    DIAGNOSIS: "Diagnosis only; no parameter of the fit",
}
_FITS = {"fit", *(each for each in (*EXTRA_SUBJECT_STAGES, *EXTRA_SITE_STAGES) if each.startswith("fit"))}
_FEW = 4  # so many are shown without folding those that change no parameter directly


@dataclass(frozen=True)
class SourcedWarning:
    """A warning and its source: a stage with its site, "levels p1", "parameters" or "report"."""

    source: str
    text: str

    @property
    def kind(self) -> str:
        """One of CHANGES.

        >>> [SourcedWarning(each, "").kind for each in ("fit p1", "mesh p1", "levels p1", "socket")]
        ['parameters', 'model', 'levels', 'limb']
        """
        first = self.source.partition(" ")[0]
        if first in _FITS:
            return PARAMETERS
        if first == "socket":
            return LIMB
        return first if first in CHANGES else MODEL


@dataclass(frozen=True)
class WarningGroup:
    """Warnings that can change the same thing.

    size : how much, in units of the result, if that was computed; else ""
    folded : whether the page shows them only on demand
    """

    changes: str
    size: str
    warnings: tuple[SourcedWarning, ...]
    folded: bool


def warning_groups(warnings: Sequence[SourcedWarning], page: ReportData) -> tuple[WarningGroup, ...]:
    """The groups that are not empty, the most important first."""
    groups = []
    for kind, changes in CHANGES.items():
        own = tuple(each for each in warnings if each.kind == kind)
        folded = kind in (MODEL, LIMB, DIAGNOSIS) and len(warnings) > _FEW
        if own:
            groups.append(WarningGroup(changes, _size(page) if kind == MODEL else "", own, folded))
    return tuple(groups)


def _size(page: ReportData) -> str:
    """What the fits found when they changed their models, in percent of the force."""
    results = [(site.name, page.outcomes.of("fit", site.name).usable) for site in page.sites]
    found = [(name, model_check_words(result.data)) for name, result in results if result is not None]
    told = [f"{name}: {words}" if len(page.sites) > 1 else words for name, words in found if words]
    return "; ".join(told)
