"""fit: identify the tissue parameters of a site from its force-depth curve.

The paper's method: c is computed from the shear-wave speed at level 0 and held fixed; f_kappa is
identified with m = 2 first, then f_kappa and m together. Every value is reported with its uncertainty.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import CaseError, SolveError
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.fitting.exports import write_mat_file
from limbcli.fitting.fitted_cycle import through_cycle, write_cycle
from limbcli.fitting.force_curves import FileCurve, ReferenceCurve
from limbcli.fitting.geometry import site_geometry_uncertainty, write_geometry
from limbcli.fitting.kept_solves import CheckSolver, KeptSolves, checked_levels
from limbcli.fitting.layer_comparison import write_layers
from limbcli.fitting.model_checks import (
    ChangedForces,
    boundary_modes,
    changed_forces,
    moved_parameters,
    write_boundary_check,
    write_contact_check,
)
from limbcli.fitting.numerical_error import gain_deviation, studied_error
from limbcli.fitting.options import FitOptions, check_choice, check_numbers
from limbcli.fitting.predicted_speeds import write_speeds
from limbcli.fitting.result import write_agreement, write_result, write_tissue_force, write_widening
from limbcli.fitting.stiffness_map import tissue_map, write_tissue_map
from limbcli.fitting.table import NAMES, Identified
from limbcli.inference.adaptive import Intervals
from limbcli.inference.geometry_uncertainty import no_narrower
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.profile_intervals import Stiffness, force_intervals
from limbcli.inference.two_step_fit import START_F_KAPPA, CurveMatch, FittedStep, ForceDepth, two_step
from limbcli.measurement.indentation import Levels, level_warnings
from limbcli.measurement.speed_noise import mean_speed_deviation
from limbcli.model import Array, ElementMap, LimbModel
from limbcli.numbers.interval_limits import Flag
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import note_templates, noted
from limbcli.provenance.staleness import Chain
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.site_model.indentation_model import with_penalty, with_tissue
from limbcli.site_model.site_layers import held_layers
from limbcli.site_model.site_levels import layer_noise, levels_of, speed_noise
from limbcli.site_model.site_states import one_state
from limbcli.solvers import choose
from limbcli.solvers.reference import ReferenceSolver
from limbcli.solvers.solver import Simulation, Solver
from limbcli.stages.build_feb import tissue_stiffness

if TYPE_CHECKING:
    from limbcli.solvers.session import Solved

__all__ = [
    "STAGE", "START", "FitOptions", "built_model", "check_choice", "check_numbers", "fit", "force_depth_data",
    "initial_stiffness",
]  # fmt: skip

STAGE = "fit"
_MOST_SOLVES = 12  # usual number of additional simulations for the intervals
START = np.array([START_F_KAPPA, 2.0])
_FIRST_SOLVES = 2  # greatest number of additional simulations for the interval of the first step


def fit(
    case: Case, *, out: Path, sites: list[str] | None = None, solver: str = "auto", febio: Path | None = None,
    options: FitOptions | None = None, progress: Progress = SILENT,
) -> list[StageResult]:  # fmt: skip
    """Identify the tissue parameters of each site with the model that `build-feb` wrote.

    Writes fit.json, curves.csv (measured and simulated forces), fit.png, profiles.png,
    parameters.csv, fit.mat, material.feb, fitted.feb and the records of its run, and the shear-wave
    speeds that the fitted model predicts: swe.csv, swe/level_00.csv ..., swe.png, swe-maps.png; if
    layers were read, also layers.csv and layers.png.

    Raises as `limbcli.fit`.
    """
    options = options or FitOptions()
    check_numbers(options)
    engine = choose(solver, febio)
    results = []
    for site in case.selected(sites):
        progress.event("stage", name=STAGE, site=site.name)
        with open_stage(out, STAGE, subject=case.subject, site=site.name) as writer:
            writer.data["asked"] = options.requested()
            note_templates(writer, options.templates)
            _fit_site(noted(case, writer), site.name, out, writer, engine, options, progress)
        results.append(writer.result)
    return results


def _fit_site(
    case: Case, name: str, out: Path, writer: StageWriter, solver: Solver, options: FitOptions,
    progress: Progress,
) -> None:  # fmt: skip
    clock = time.perf_counter()
    site = case.site(name)
    levels = levels_of(site, options.cycle)
    model = through_cycle(built_model(case, site, out, writer), levels, site)
    stiffness, c_source, c = _tissue_c(model, levels, site, options, writer)
    kept = KeptSolves.of_site(out, name)
    curve, forward, cold = _first_solve(solver, model, c, kept, options, progress)
    match, knots = CurveMatch(curve, forward.depths, force_depth_data(levels, site)), forward.depths
    with contextlib.closing(curve):
        steps = two_step(
            match, tolerance=options.tolerance, max_iterations=options.max_iterations, progress=progress
        )
        theta = steps[-1].theta
        levels_there = forward.levels_at(theta)
        given = options.gain_deviation
        studied = None if given is not None else studied_error(case, site, out, writer)
        gains = [gain_deviation(model, given, studied=studied, f_kappa=float(x.theta[0])) for x in steps]
        share = _share_of_c(forward.share_of_c, theta, writer) if held_layers(model) else None
        known = [replace(stiffness, gain_deviation=each, share=share) for each in gains]
        fitted = with_tissue(model, c=c, f_kappa=float(theta[0]), m=float(theta[1]))
        forces = curve(theta).values
        uncertainty = site_geometry_uncertainty(case, site, out, fitted, forces, writer, progress=progress)
        checked = checked_levels(fitted)
        again = CheckSolver(levels=levels_there, rows=checked, kept=kept, progress=progress)
        changed: list[ChangedForces] = []
        if options.boundary_check:
            changed = changed_forces(
                fitted, forces[checked], lambda each: again.forces(each.of(fitted)), progress=progress
            )
        modes = boundary_modes(changed, knots[checked], knots)
        if uncertainty is not None:
            modes = np.vstack([uncertainty.modes, modes])
        intervals, of_noise, why_none = None, None, "no interval was requested"
        if not (site.noise.force > 0 or site.noise.depth > 0):
            why_none = "the case states no noise of force or depth"
            writer.warnings.append(
                f"site {site.name}: {why_none} (force_n and depth_mm of [site.noise] are 0), so the "
                "uncertainty of the parameters cannot be determined"
            )
        elif options.intervals:
            most = options.most_solves(_MOST_SOLVES)
            search = partial(_intervals, match, known, steps, max_solves=most, progress=progress)
            # the wide ones first, as the solves at their ends serve the narrower ones too
            wide = search(modes=modes) if len(modes) else None
            intervals = of_noise = search()
            if wide is not None:
                intervals = (no_narrower(wide[0], of_noise[0]), no_narrower(wide[1], of_noise[1]))
        identified = Identified(
            **vars(match), known=known, c_source=c_source, start=START, steps=steps, intervals=intervals,
            cold_seconds=cold, why_no_intervals=why_none, modes=modes if len(modes) else None,
        )  # fmt: skip
        simulation = _write_fitted_run(fitted, solver, levels_there, writer, options, progress)
        write_result(identified, fitted, simulation, writer, site, seconds=time.perf_counter() - clock)
        writer.data["n_kept_solves"] = forward.n_kept if isinstance(forward, ReferenceCurve) else 0
        write_cycle(levels, site, writer)
        if site.states:
            writer.warnings.insert(0, one_state(site))
        if uncertainty is not None:
            write_geometry(identified, uncertainty, of_noise[-1] if of_noise else None, writer)
        _write_checks(identified, fitted, again, changed, writer, options)
        write_tissue_force(identified, fitted.contacts[0].penalty, writer)
        if of_noise is not None and len(modes):
            write_widening(of_noise[-1], writer)
        write_speeds(fitted, simulation, levels, site, writer)
        write_agreement(identified, writer)
        write_layers(fitted, simulation, levels, site, writer)
        write_mat_file(writer)


def _write_checks(
    found: Identified, fitted: LimbModel, again: CheckSolver, changed: Sequence[ChangedForces],
    writer: StageWriter, options: FitOptions,
) -> None:  # fmt: skip
    """Write what a stiffer contact and other boundaries (`changed`) change, as far as the options ask."""
    theta, depths = found.steps[-1].theta, found.knots[again.rows]
    if options.contact_check:
        write_contact_check(
            fitted.contacts[0].penalty, found.curve(theta).values[again.rows], depths,
            lambda penalty: again.forces(with_penalty(fitted, penalty)), writer, progress=again.progress,
        )  # fmt: skip
    if options.boundary_check:
        free = {k: name for k, name in enumerate(NAMES) if writer.data["flags"][name] == Flag.IDENTIFIED}
        parameters = partial(moved_parameters, found, theta, free, depths)
        write_boundary_check(changed, depths, writer, parameters=parameters)


def _intervals(
    match: CurveMatch, known: Sequence[Stiffness], steps: Sequence[FittedStep], *, modes: Array | None = None,
    max_solves: int, progress: Progress,
) -> tuple[Intervals, Intervals]:  # fmt: skip
    """Profile-likelihood intervals of both steps; known : c and its uncertainty at each, modes : changes of
    ln force by uncertain geometry and boundaries, to be included"""
    match.curve.expect(max_solves + _FIRST_SOLVES)
    full = force_intervals(
        match, known[-1], steps[-1].theta, max_solves=max_solves, shape_modes=modes, progress=progress
    )
    first = force_intervals(
        match, known[0], steps[0].theta, free=(0,), max_solves=_FIRST_SOLVES, shape_modes=modes
    )
    return first, full


def _tissue_c(
    model: LimbModel, levels: Levels, site: Site, options: FitOptions, writer: StageWriter
) -> tuple[Stiffness, str, float | ElementMap]:
    """c with its uncertainty, its source in words, and c as the law takes it: a number or a map (MPa)."""
    if not options.stiffness_map:
        stiffness, source = initial_stiffness(levels, site, options)
        return stiffness, source, stiffness.c
    if options.c_kpa is not None:
        raise CaseError(
            "c is given twice: by hand and as a map",
            where="--c-kpa, --stiffness-map",
            fix="omit one of the two",
        )
    found = tissue_map(model, site, row=int(levels.rows[0]))
    write_tissue_map(found, model, levels, site, writer)
    stiffness = found.stiffness(site)
    if options.c_deviation is not None:
        stiffness = Stiffness(stiffness.c, options.c_deviation)
    return stiffness, found.words, found.c


def built_model(case: Case, site: Site, out: Path, writer: StageWriter, *, label: str = "") -> LimbModel:
    """Read the model that build-feb wrote for this site, after checking that its inputs are unchanged; label
    : names the site in what is recorded, where several are used
    """
    prefix = f"{label}/" if label else ""
    built = Chain(case, out).result("build-feb", site=site.name)
    feb = built.folder / "model.feb"
    writer.used_result(built, files=["feb"])
    writer.used(f"{prefix}model", feb)
    of_levels = level_warnings(site.levels, noise=layer_noise(site))
    for each in dict.fromkeys([*built.warnings, *of_levels]):
        text = f"site {label}: {each}" if label and each in of_levels else each
        if text not in writer.warnings:
            writer.warnings.append(text)
    return read_feb(feb)


def force_depth_data(levels: Levels, site: Site) -> ForceDepth:
    """The loading levels, with the noise stated by the case."""
    rows = levels.loading
    noise = site.noise
    return ForceDepth(levels.force[rows], levels.depth[rows], noise.force, noise.depth)


def initial_stiffness(levels: Levels, site: Site, options: FitOptions) -> tuple[Stiffness, str]:
    """c = 2 rho v^2 of level 0 or the value given by hand, with its uncertainty, and its source in words.

    The standard deviation of ln c is twice the relative one of the mean speed (`mean_speed_deviation`).
    """
    c, source = tissue_stiffness(levels, site, c_kpa=options.c_kpa)
    if options.c_deviation is not None:
        return Stiffness(c, options.c_deviation), source
    return Stiffness(c, 2.0 * float(mean_speed_deviation(levels, speed_noise(site))[0])), source


def _first_solve(
    solver: Solver, model: LimbModel, c: float | ElementMap, kept: KeptSolves, options: FitOptions,
    progress: Progress,
) -> tuple[SolvedPoints, ReferenceCurve | FileCurve, float]:  # fmt: skip
    """The force curve with its cache, the curve itself, and the time of the first solve (s; NaN if kept)."""
    clock = time.perf_counter()
    if solver.name == "reference":
        exact = ReferenceCurve(model, c=c, kept=kept, progress=progress)
        curve = SolvedPoints(exact)
        try:
            curve(START, (0, 1))
        except BaseException:
            curve.close()
            raise
        return curve, exact, float("nan") if exact.n_kept else time.perf_counter() - clock
    files = FileCurve(solver, model, c=c, time_limit_s=options.time_limit_s)
    curve = SolvedPoints(files.differentiable())
    curve(START)
    return curve, files, time.perf_counter() - clock


def _share_of_c(share_of_c: Callable[[Array], Array], theta: Array, writer: StageWriter) -> Array | None:
    """d ln force / d ln c at the levels beside fixed layers; None, with a warning, if unknown."""
    try:
        share = share_of_c(theta)
    except SolveError as error:
        writer.warnings.append(
            "how much of c's uncertainty propagates to the force was not evaluated: "
            f"{error.what}; full propagation is assumed"
        )
        return None
    writer.data["c_share_of_force"] = share
    return share


def _write_fitted_run(
    fitted: LimbModel, solver: Solver, levels: Solved | None, writer: StageWriter, options: FitOptions,
    progress: Progress,
) -> Simulation:  # fmt: skip
    """Write fitted.feb, which FEBio Studio can open, run it, and register the records of its run."""
    feb = write_feb(fitted, writer.file("feb", "fitted.feb"), options.templates)
    if levels is not None and isinstance(solver, ReferenceSolver):
        solver.begin_with(feb, levels)
    solver.run(feb, progress=progress, time_limit_s=options.time_limit_s)
    for name in ["model.log", *(record.file for record in fitted.records)]:
        if (writer.work / name).is_file():
            writer.file(Path(name).stem.replace("model", "log"), name)
    return solver.read(feb)
