"""Summary of a record's loading cycles in numbers and words, for `check`, `diagnose` and the report."""

from __future__ import annotations

from typing import Any

from limbcli.case import Case, Site
from limbcli.measurement.cycle_changes import change_text, support_text
from limbcli.measurement.indentation import Levels, check_levels
from limbcli.measurement.repeated_loading import CycleStudy
from limbcli.site_model.site_levels import cycles_of


def cycle_sentences(site: Site, levels: Levels, study: CycleStudy) -> list[str]:
    """Sentences on the cycle from which the response is repeatable, earlier changes, and a moving support."""
    if not study.differences:
        return [
            "There is one complete loading: these data do not show whether the tissue response is repeatable."
        ]
    last = study.differences[-1].later
    if study.repeats_from is None:
        lines = [
            f"Cycle {last} still differs from cycle {study.differences[-1].earlier} beyond noise: the "
            "tissue response was not yet repeatable."
        ]
    elif study.repeats_from == study.differences[0].earlier:
        lines = [f"All loadings up to cycle {last} follow one curve within noise."]
    else:
        lines = [f"From cycle {study.repeats_from} on the tissue response is repeatable within noise."]
    if not study.differences[0].is_noise:
        lines.append(capital(change_text(study.differences[0])) + ".")
    moved = support_text(levels, study, travel_deviation=site.noise.depth)
    if moved is not None:
        lines.append(capital(moved) + ".")
    return lines


def cycle_lines(case: Case) -> list[str]:
    """One line for each site that was loaded several times; none for files that cannot be read."""
    lines = []
    for site in case.sites:
        levels = check_levels(site.levels)[0] if site.levels.is_file() else None
        if levels is None or len(levels.cycles) == 1:
            continue
        counts = ", ".join(str(levels.n_loading(each)) for each in levels.cycles)
        lines.append(
            f"site {site.name}: {len(levels.cycles)} cycles ({counts} levels of loading); `fit` uses "
            f"the last complete one, {levels.chosen_cycle()}"
        )
    return lines


def cycle_facts(site: Site, levels: Levels) -> dict[str, Any] | None:
    """The same as data for a result's JSON; None if the tissue was loaded once."""
    if len(levels.cycles) == 1:
        return None
    study = cycles_of(site, levels)
    return {
        "n": len(levels.cycles),
        "used": levels.chosen_cycle(),
        "repeats_from": study.repeats_from,
        "energy_lost_n_mm": {str(cycle): each.lost for cycle, each in study.energy.items()},
        "energy_lost_fraction": {str(cycle): each.share for cycle, each in study.energy.items()},
        "sentences": cycle_sentences(site, levels, study),
    }


def capital(text: str) -> str:
    """
    >>> capital("from cycle 1 on"), capital("")
    ('From cycle 1 on', '')
    """
    return text[:1].upper() + text[1:]
