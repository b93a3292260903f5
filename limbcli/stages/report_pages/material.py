"""Collects the data of a report page from the results of the stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import LimbError, MeasurementError
from limbcli.errors.problems import errors_of
from limbcli.files.atomic import sha256
from limbcli.fitting.fitted_cycle import contradiction
from limbcli.measurement.indentation import Levels, check_levels, level_warnings
from limbcli.measurement.regression import Line, speed_line
from limbcli.measurement.repeated_loading import CycleStudy
from limbcli.model.patient_frame import side_of
from limbcli.progress import SILENT, Progress
from limbcli.provenance.remaking_command import commands
from limbcli.provenance.staleness import BrokenLink, Chain
from limbcli.reporting.figures.force_depth import MeasuredCurve
from limbcli.reporting.figures.hysteresis_loops import Loop
from limbcli.reporting.figures.wave_speed import SpeedReadings
from limbcli.reporting.outcome import Outcome, Outcomes, read_outcomes
from limbcli.reporting.report_data import CycleMaterial, ReportData, SiteMaterial
from limbcli.results import UNLIKE_OURS, StageResult
from limbcli.site_model.cycle_words import capital, cycle_sentences
from limbcli.site_model.site_levels import cycles_of, layer_noise
from limbcli.stages.report_pages.simulated_state import limb_place, limb_skin, read_deformed, read_residuals


def gather(case: Case, *, out: Path, progress: Progress = SILENT) -> ReportData:
    """Read everything that the page shows; for what cannot be read, the page gets the reason."""
    names = tuple(site.name for site in case.sites)
    outcomes = read_outcomes(out, names, case_name=str(case.folder), subject=case.subject)
    sites, skin = [], limb_skin(outcomes)
    for k, site in enumerate(case.sites):
        progress.event("task", name="report: reading results", done=k, total=len(names))
        found = _deformed(_measured(site, _fitted_cycle(outcomes, site.name)), outcomes)
        sites.append(replace(found, on_limb=limb_place(case, site, skin, outcomes)))
    progress.event("task", name="report: reading results", done=len(names), total=len(names))
    return ReportData(
        case=case, case_name=str(case.folder), out=out, outcomes=outcomes, sites=tuple(sites),
        notices=(*stale_results(case, out, outcomes), *_older_results(outcomes, names)),
    )  # fmt: skip


def _fitted_cycle(outcomes: Outcomes, name: str) -> int | None:
    """The cycle used by the site's fit; None if there was only one, or no fit."""
    result = outcomes.of("fit", name).result
    cycle = result.data.get("cycle") if result is not None else None
    return int(cycle["fitted"]) if isinstance(cycle, dict) and "fitted" in cycle else None


def _measured(site: Site, fitted: int | None) -> SiteMaterial:
    """The levels of the fitted (else the last) cycle with their speed lines, or why there are none."""
    material = SiteMaterial(site.name, _place(site))
    levels, problems = check_levels(site.levels, noise=layer_noise(site))
    if levels is None or errors_of(problems):
        why = "; ".join(each.what for each in errors_of(problems)) or "no level could be read"
        return replace(material, why_no_levels=f"{site.levels.name} cannot be used: {why}.")
    warnings = level_warnings(site.levels, noise=layer_noise(site))
    repeated = cycle_material(site, levels, fitted)
    levels = levels.of_cycle(fitted if fitted in levels.cycles else levels.chosen_cycle())
    noise = site.noise
    curve = MeasuredCurve(levels.depth, levels.force, noise.depth, noise.force, unloading=~levels.loading)
    return replace(_with_speeds(material, levels), measured=curve, warnings=warnings, cycles=repeated)


def _place(site: Site) -> str:
    axis = site.long_axis if isinstance(site.long_axis, str) else "along a given direction"
    where = f"marker {site.marker}" if site.marker is not None else ""
    if site.position is not None:
        where = "at " + ", ".join(f"{each:.1f}" for each in site.position) + " mm (LPS)"
    return f"{where}, probe {axis}"


def _with_speeds(material: SiteMaterial, levels: Levels) -> SiteMaterial:
    if not levels.has_swe:
        return material
    speeds = SpeedReadings(levels.force, levels.depth, levels.swe_mean_m_per_s, levels.swe_sd_m_per_s)
    loading = np.asarray(levels.loading, dtype=bool)
    lines: list[Line | None] = []
    why = ""
    for against, x in (("force", levels.force), ("depth", levels.depth)):
        try:
            lines.append(speed_line(x[loading], levels.swe_mean_m_per_s[loading], against=against))
        except MeasurementError as error:
            lines.append(None)
            why = f"No line: {error.what}."
    return replace(material, speeds=speeds, against_force=lines[0], against_depth=lines[1], why_no_line=why)


def _deformed(material: SiteMaterial, outcomes: Outcomes) -> SiteMaterial:
    """The simulated state, of the fitted model if there is one, and the solver's residuals."""
    for stage in ("fit", "run"):
        outcome = outcomes.of(stage, material.name)
        if outcome.result is None or outcome.status == "failed":
            continue
        if material.residuals is None:
            material = replace(material, residuals=read_residuals(outcome.result))
        if material.deformed is None:
            material = _with_state(material, outcome, outcome.result, outcomes)
    return material


def _with_state(
    material: SiteMaterial, outcome: Outcome, result: StageResult, outcomes: Outcomes
) -> SiteMaterial:
    try:
        state = read_deformed(result)
    except (LimbError, OSError, ValueError, KeyError, StopIteration) as error:
        what = error.what if isinstance(error, LimbError) else f"{type(error).__name__} {error}"
        why = f"The deformed model of “{outcome.label}” cannot be drawn: {what}."
        return replace(material, why_not_deformed=why)
    state = replace(state, sides=_sides(outcomes.of("mesh", material.name).usable)) if state else None
    return replace(material, deformed=state, deformed_source=f"the records of “{outcome.label}”")


def _sides(meshed: StageResult | None) -> tuple[str, str] | None:
    """The sides of the patient to which x and y of the model point, if the mesh's result contains them."""
    try:
        rotation = meshed.data["frame"]["patient_from_model"] if meshed is not None else None
        axes = np.asarray(rotation, dtype=float)[:3, :2]
        return side_of(axes[:, 0]), side_of(axes[:, 1])
    except UNLIKE_OURS:
        return None


# Results that a stage resembles or uses if it is there, without recording it as an input.
_NOT_RECORDED = (("mesh", "mesh-study"), ("build-feb", "diagnose"))


def _older_results(outcomes: Outcomes, sites: Sequence[str]) -> list[str]:
    """Sentences on results older than others that they do not record as their inputs."""
    reported = [
        _older(outcomes.of(before, site), outcomes.maybe(after, site))
        for site in sites
        for before, after in _NOT_RECORDED
    ]
    return [each for each in reported if each]


def _older(before: Outcome, after: Outcome | None) -> str:
    """The sentence for a result made before the one that it builds on; empty otherwise."""
    if after is None or before.result is None or after.result is None:
        return ""
    if before.label in after.result.provenance.get("made_from", {}).get("results", {}):
        return ""
    early, late = (str(r.provenance.get("finished_utc", "")) for r in (before.result, after.result))
    if not late or early <= late:
        return ""
    return (
        f"The result of “{after.label}” ({late}) is older than that of “{before.label}” ({early}) "
        f"on which it is based; run it again: {after.command}"
    )


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


def stale_results(case: Case, out: Path, outcomes: Outcomes) -> list[str]:
    """Sentences on what has changed, which results are out of date, and the commands that update them."""
    chain = Chain(case, out)
    causes: dict[str, list[tuple[str, BrokenLink]]] = {}
    for outcome in outcomes.done:
        assert outcome.result is not None
        broken = chain.broken(outcome.result)
        if broken is not None:
            causes.setdefault(broken.what, []).append((outcome.label, broken))
    return [_sentence(case, out, what, found) for what, found in causes.items()] + _altered_pictures(outcomes)


def _altered_pictures(outcomes: Outcomes) -> list[str]:
    """Sentences on pictures of the page that are no longer what their stage drew."""
    return [
        f"{path.name}, drawn by `{result.label}`, was changed since ({path}): the page shows it as it is now"
        for result in (each.result for each in outcomes.done if each.result is not None)
        for name, digest in result.provenance.get("pictures_sha256", {}).items()
        if (path := result.path(name)).is_file() and sha256(path) != digest
    ]


def _sentence(case: Case, out: Path, what: str, found: list[tuple[str, BrokenLink]]) -> str:
    labels = ", ".join(f"“{label}”" for label, _ in found)
    steps = [step for _, broken in found for step in broken.steps]
    return (
        f"{what[0].upper()}{what[1:]} ({found[0][1].where}): what is shown of {labels} is out of date "
        f"with the case; run {commands(steps, case.folder, out)}"
    )
