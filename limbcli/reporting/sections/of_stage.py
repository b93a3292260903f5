"""Sections that show the result of one stage."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

from limbcli.reporting.report_data import ReportData, SiteMaterial
from limbcli.reporting.reportlet import Reportlet, placeholder
from limbcli.results import UNLIKE_OURS


def of_stage(
    stage: str, key: str, title: str, *, silent: bool = False
) -> Callable[[Callable[..., Reportlet | None]], Callable[..., Reportlet | None]]:
    """Decorator of a section about a stage, of the subject or of one site, which is called with its result.

    A stage that failed, or has yet to be run, gives a placeholder; an optional one that was not run, None. A
    result that lacks what the section shows is told to be run again.

    key : unique on the page, of a site with the site's name
    silent : None instead of a placeholder, where another section tells that there is no result
    """

    def decorate(section: Callable[..., Reportlet | None]) -> Callable[..., Reportlet | None]:
        @functools.wraps(section)
        def shown(page: ReportData, site: SiteMaterial | None = None) -> Reportlet | None:
            name = site.name if site else None
            own_key = f"{key}-{name}" if name else key
            outcome = page.outcomes.maybe(stage, name)
            if outcome is None:
                return None
            if outcome.usable is None:
                return None if silent else placeholder(own_key, title, outcome)
            try:
                made = section(outcome.usable, page, site) if site else section(outcome.usable, page)
            except UNLIKE_OURS as error:
                text = f"Its result cannot be shown ({type(error).__name__}: {error}); run it again."
                made = Reportlet(mood="failed", warned=(text,), command=outcome.command)
            return made and replace(made, key=own_key, title=made.title or title, site=name)

        return shown

    return decorate
