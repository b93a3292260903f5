"""Force-depth loops and sentences of the page for a record with several cycles."""

from __future__ import annotations

import numpy as np

from limbcli.case import Site
from limbcli.fitting.fitted_cycle import contradiction
from limbcli.measurement.indentation import Levels
from limbcli.measurement.repeated_loading import CycleStudy
from limbcli.reporting.figures.hysteresis_loops import Loop
from limbcli.reporting.report_data import CycleMaterial
from limbcli.site_model.cycle_words import capital, cycle_sentences
from limbcli.site_model.site_levels import cycles_of


def cycle_material(site: Site, levels: Levels, fitted: int | None) -> CycleMaterial | None:
    """Loops and sentences of all cycles; None if the tissue was loaded once and not unloaded.

    levels : of all cycles; fitted : the cycle used by `fit`, None if there is no fit
    """
    if len(levels.cycles) == 1 and levels.loading.all():
        return None
    study = cycles_of(site, levels)
    against = study.contradicting(fitted) if fitted is not None else ()
    return CycleMaterial(
        loops=tuple(_loop(levels, study, cycle) for cycle in levels.cycles),
        sentences=tuple(cycle_sentences(site, levels, study)),
        settled=study.repeats_from is not None or len(levels.cycles) == 1,
        contradiction=capital(contradiction(against[0])) + "." if against else "",
    )


def _loop(levels: Levels, study: CycleStudy, cycle: int) -> Loop:
    mine = levels.cycle == cycle
    up, down = (np.flatnonzero(mine & each) for each in (levels.loading, ~levels.loading))
    there, back = ((levels.depth[rows], levels.force[rows]) for rows in (up, down))
    energy = study.energy.get(cycle)
    if energy is None:
        return Loop(cycle, there, back)
    return Loop(cycle, there, back, energy.lost, energy.lost_deviation, energy.share)
