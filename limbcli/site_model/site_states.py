"""The levels of a site's states, each checked like a site's own levels and for a speed at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.case import Case, Site
from limbcli.case.noting import with_values
from limbcli.case.parts import StretchState
from limbcli.errors import LimbError, MeasurementError
from limbcli.errors.problems import Problem, checked
from limbcli.measurement.indentation import Levels
from limbcli.site_model.site_levels import levels_of


@dataclass(frozen=True, eq=False)
class MeasuredState:
    """A state and its last loading; depths (mm) are from first touch in that state."""

    state: StretchState
    levels: Levels


def states_of(site: Site) -> list[MeasuredState]:
    """Every state of a site with its levels; empty if the site has no states.

    Raises MeasurementError listing every problem of the files, including states without a speed at rest.
    """
    found, problems = _read(site)
    return checked(found, problems, MeasurementError)


def one_state(site: Site) -> str:
    """Warning of a stage that does not support states, for a site that has some."""
    return (
        f"site {site.name} was measured in {len(site.states)} states; this uses the "
        f"first ({site.states[0].name}) and treats its tissue as unloaded. `limbcli fit --objective "
        "states` determines how far it is stretched"
    )


def state_problems(case: Case) -> list[Problem]:
    """Problems of the states' rows at rest; other problems are reported by the files' readers."""
    return [
        problem
        for site in case.sites
        for each in site.states
        if (problem := _at_rest(site, each)) is not None
    ]


def _read(site: Site) -> tuple[list[MeasuredState], list[Problem]]:
    found: list[MeasuredState] = []
    problems: list[Problem] = []
    for state in site.states:
        try:
            found.append(MeasuredState(state, _levels(site, state)))
        except LimbError as error:
            problems.append(Problem(error.what, error.where, error.fix))
            continue
        wrong = _without_rest(site, state, found[-1].levels)
        problems += [] if wrong is None else [wrong]
    return found, problems


def _levels(site: Site, state: StretchState) -> Levels:
    return levels_of(with_values(site, levels=state.levels))


def _at_rest(site: Site, state: StretchState) -> Problem | None:
    try:
        return _without_rest(site, state, _levels(site, state))
    except LimbError:
        return None


def _without_rest(site: Site, state: StretchState, levels: Levels) -> Problem | None:
    if levels.begins_at_zero and np.isfinite(levels.swe_mean_m_per_s[0]):
        return None
    lacks = "shear-wave speed at rest" if levels.begins_at_zero else "level at rest (0 N)"
    return Problem(
        f"state {state.name} of site {site.name} has no {lacks}",
        str(state.levels),
        "make its first row the reading at first touch, 0 N and 0 mm, with swe_mean_m_per_s; the "
        "stretch of a state is determined from its speed at rest",
        family="measurement",
    )
