"""The chapters of the page, in reading order."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, replace
from typing import Any

from limbcli.reporting.numbers import DASH
from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Cell, Reportlet, table
from limbcli.reporting.sections.convergence import convergence, profiles
from limbcli.reporting.sections.deformation import deformation, layers
from limbcli.reporting.sections.diagnosis import diagnosis
from limbcli.reporting.sections.elastography import elastography
from limbcli.reporting.sections.force_depth import force_over_depth
from limbcli.reporting.sections.joint_fit import joint, laws
from limbcli.reporting.sections.limb import limb, socket
from limbcli.reporting.sections.methods import methods
from limbcli.reporting.sections.numerics import elements, fibres, mesh, mesh_study
from limbcli.reporting.sections.parameters import parameters
from limbcli.reporting.sections.provenance import provenance
from limbcli.reporting.sections.repeatability import repeated_loading
from limbcli.reporting.sections.segmentation import segmentation
from limbcli.reporting.sections.unloaded_state import states


@dataclass(frozen=True, eq=False)
class SectionGroup:
    """A chapter: of the subject, or of one site."""

    key: str
    title: str
    reportlets: tuple[Reportlet, ...]


SITE_REPORTLETS: tuple[Callable[[ReportData, SiteMaterial], Reportlet | None], ...] = (
    force_over_depth, states, repeated_loading, layers, diagnosis, profiles, elastography, elements,
    deformation, fibres, mesh, mesh_study, convergence,
)  # fmt: skip


def groups(
    page: ReportData, own: Mapping[str, Any], *, told: Container[str] = ()
) -> tuple[SectionGroup, ...]:
    """Results first, then their basis, then their provenance.

    told : warnings at the top of the page, which a section only refers to
    """
    sites = [_site(page, site) for site in page.sites]
    whole = _there(limb(page), socket(page))
    found = _there(parameters(page), joint(page), laws(page)) if page.sites else ()
    chapters = (
        *([SectionGroup("chapter-parameters", "Parameters", found)] if found else ()),
        *sites,
        *([SectionGroup("chapter-limb", "Whole limb", whole)] if whole else ()),
        SectionGroup("chapter-segmentation", "Segmentation", _there(segmentation(page))),
        SectionGroup("chapter-provenance", "Provenance", (methods(page, own), provenance(page, own))),
    )
    return tuple(
        replace(each, reportlets=tuple(_told_once(one, told) for one in each.reportlets)) for each in chapters
    )


def _there(*reportlets: Reportlet | None) -> tuple[Reportlet, ...]:
    return tuple(each for each in reportlets if each is not None)


def _told_once(reportlet: Reportlet, told: Container[str]) -> Reportlet:
    own = tuple(each for each in reportlet.warned if each not in told)
    return replace(reportlet, warned=own, n_above=len(reportlet.warned) - len(own))


def _site(page: ReportData, site: SiteMaterial) -> SectionGroup:
    reportlets = _there(*(make(page, site) for make in SITE_REPORTLETS))
    shown = [each for each in reportlets if not _is_gap(each)]
    gaps = [each for each in reportlets if _is_gap(each)]
    if len(gaps) > 1:
        gaps = [_together(site, gaps)]
    return SectionGroup(f"site-{site.name}", f"Site {site.name}", (*shown, *gaps))


def _is_gap(reportlet: Reportlet) -> bool:
    return reportlet.mood == "missing" and not reportlet.is_answered


def _together(site: SiteMaterial, gaps: list[Reportlet]) -> Reportlet:
    """Combine several questions that cannot be answered yet: the reason for each, and the command that
    provides it."""
    unknown = Cell(DASH, reason="see the reason beside it")
    rows = [(each.title, " ".join(each.notes), each.command or unknown) for each in gaps]
    caption = f"Sections not yet available at site {site.name}"
    missing = table(caption, ("question", "why not", "made by"), rows, numeric=False)
    return Reportlet(f"gaps-{site.name}", "What is still missing?", "missing", site.name, tables=(missing,))
