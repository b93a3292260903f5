"""fit --objective states: one tissue measured in several states, each stretched before the probe touches it.

The likelihood is that of the joint fit; c is free. All states share one simulated curve, evaluated for each
state at the tissue's stretch before the probe touches it (`site_model.prestretch`).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import CaseError, MeasurementError
from limbcli.fitting.exports import write_mat_file
from limbcli.fitting.geometry import NOT_ALLOWED_FOR
from limbcli.fitting.laws import FitLaw, first_shapes, law_named
from limbcli.fitting.least_stiffness import FittedStates
from limbcli.fitting.numerical_error import gain_deviation, studied_error
from limbcli.fitting.state_curve import StateCurve
from limbcli.fitting.state_plan import StretchPlan, stretch_plan
from limbcli.fitting.states_result import write_states
from limbcli.inference.adaptive import Intervals
from limbcli.inference.joint_fit import JointProblem, JointTask, joint_fit
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.site_depth import SiteMeasurement
from limbcli.measurement.shear_modulus import shear_modulus_from_wave_speed
from limbcli.model import Array
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import noted
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.site_model.site_layers import held_layers
from limbcli.site_model.site_states import MeasuredState, states_of
from limbcli.stages.fit import FitOptions, built_model, check_numbers
from limbcli.stages.fit_joint import check_noise, site_data

STAGE = "fit-states"
_MOST_ROUNDS = 3  # usual number of rounds of simulations for the intervals
_KNOTS = 6  # number of simulated depths
# Largest simulated depth as a multiple of the deepest reading; exponent of the spacing of simulated depths
# (above 1 they are denser near first touch).
_BEYOND, _BEND = 1.05, 1.25
_LEAST_DEPTH = 0.5  # mm, least value of the first simulated depth


def fit_states(
    case: Case, *, out: Path, sites: list[str] | None = None, options: FitOptions | None = None,
    progress: Progress = SILENT,
) -> list[StageResult]:  # fmt: skip
    """Identify a common law, and a stretch for every state, at each site that has states.

    Writes fit-states.json, states.png (speed at rest against stretch), fit-states.png, profiles.png, a table
    of levels for each state, parameters.csv, fit.mat, material.feb, and <state>.feb (each fitted state for
    FEBio).

    Raises as `limbcli.fit_states`.
    """
    options = options or FitOptions()
    check_numbers(options)
    law_named(options.law)  # before any work
    selected = [site for site in case.selected(sites) if site.states]
    if not selected:
        raise CaseError(
            "no requested site has states",
            where="--objective states",
            fix="add [[site.state]] tables to the site, or use --objective force",
        )
    results = []
    for site in selected:
        progress.event("stage", name=STAGE, site=site.name)
        with open_stage(out, STAGE, subject=case.subject, site=site.name) as writer:
            clock = time.perf_counter()
            _fit_site(noted(case, writer), site.name, out, writer, options, progress)
            writer.data["asked"] = options.requested("states")
            writer.data["seconds"] = time.perf_counter() - clock
            write_mat_file(writer)
        results.append(writer.result)
    return results


def _fit_site(
    case: Case, name: str, out: Path, writer: StageWriter, options: FitOptions, progress: Progress
) -> None:
    site, law = case.site(name), law_named(options.law)
    plan = stretch_plan(site)
    measured = states_of(site)
    check_noise(site, speeds=True)
    model = built_model(case, site, out, writer)
    beside = held_layers(model)
    if beside:
        writer.warnings.append(
            f"{' and '.join(beside)}: their stiffness is taken as known; they are stretched with "
            "the tissue and unloaded where it is"
        )
    if case.imaging.assumed:
        writer.warnings.append(NOT_ALLOWED_FOR)
    given = options.gain_deviation
    studied = None if given is not None else studied_error(case, site, out, writer)
    gain = gain_deviation(model, given, studied=studied)
    c0 = _start_c(site, measured, plan)
    simulated = law.beside_layers() if beside else law
    curve = StateCurve(
        model, simulated, plan.ways, knots(measured), c=c0, density_kg_per_m3=site.density_kg_per_m3,
        progress=progress,
    )  # fmt: skip
    data = [
        replace(site_data(site, each.levels, curve.depths, gain, speeds=True), name=each.state.name)
        for each in measured
    ]
    try:
        problem, found = identify(
            curve, law, plan, data, max_rounds=options.most_solves(_MOST_ROUNDS), progress=progress
        )  # fmt: skip
        fit = FittedStates(site=site, law=law, plan=plan, curve=curve, problem=problem, found=found)
        write_states(fit, model, writer)
    finally:
        curve.close()


def identify(
    curve: StateCurve, law: FitLaw, plan: StretchPlan, data: Sequence[SiteMeasurement], *, max_rounds: int,
    progress: Progress = SILENT,
) -> tuple[JointProblem, Intervals]:  # fmt: skip
    """Run the first simulations, then the fit with its profile likelihoods.

    curve : of `law`, or of `law.beside_layers()` in a model with layers of fixed stiffness
    """
    memory = SolvedPoints(curve)
    first_simulations(memory, curve.law, plan, progress=progress)
    task = JointTask(
        [memory] * len(data), data, law.shape, curve.c, beside_layers=[curve.law.has_ratio] * len(data),
        states=plan, even_speed=curve.even_speed,
    )  # fmt: skip
    return joint_fit(task, starts(curve.c, law, plan), max_solves=max_rounds, progress=progress)


def first_simulations(
    memory: SolvedPoints, law: FitLaw, plan: StretchPlan, *, progress: Progress = SILENT
) -> None:
    """Simulate the law's start shapes at the middle of the stretches, and the first at points around it."""
    shapes = first_shapes(law)
    middle, places = plan.first_places()
    thetas = [*(np.r_[shape, middle] for shape in shapes), *(np.r_[shapes[0], place] for place in places)]
    for k, theta in enumerate(thetas):
        progress.event("task", name="first simulations", done=k, total=len(thetas))
        memory(theta, tuple(range(len(theta))))


def knots(measured: Sequence[MeasuredState]) -> list[float]:
    """Simulated depths (mm) to beyond the deepest reading; MeasurementError if none is deeper than 1 mm."""
    deepest = max(float(np.max(each.levels.depth[each.levels.loading])) for each in measured)
    if deepest < 2 * _LEAST_DEPTH:
        raise MeasurementError(
            f"the deepest reading of all states is {deepest:.2f} mm",
            where=", ".join(str(each.state.levels) for each in measured),
            fix="load deeper; check the column depth_mm: it increases from 0 with the load, in mm",
        )
    return knots_to(deepest)


def knots_to(deepest: float) -> list[float]:
    """Simulated depths (mm) up to slightly beyond `deepest`, denser near first touch.

    >>> knots_to(4.0)
    [0.5, 1.064, 1.766, 2.53, 3.344, 4.2]
    """
    depths = _BEYOND * deepest * (np.arange(1, _KNOTS + 1) / _KNOTS) ** _BEND
    depths[0] = max(depths[0], _LEAST_DEPTH)
    return [float(each) for each in np.unique(np.round(depths, 3))]


def _start_c(site: Site, measured: Sequence[MeasuredState], plan: StretchPlan) -> float:
    """c = 2 rho v^2 (MPa) at rest in the state that is least stretched at the start values."""
    values = np.array([each.start for each in plan.parameters])
    strain = [float(np.abs(np.log(plan.stretches(k, values))).max()) for k in range(len(measured))]
    speed = measured[int(np.argmin(strain))].levels.swe_mean_m_per_s[:1]
    return 2 * float(shear_modulus_from_wave_speed(speed, density_kg_per_m3=site.density_kg_per_m3)[0])


def starts(c0: float, law: FitLaw, plan: StretchPlan) -> list[Array]:
    """Initial guesses: every start shape, and the last one with each stretch times 0.88 and 1.14."""
    shapes, values = first_shapes(law), np.array([each.start for each in plan.parameters])
    found = [np.r_[c0, shape, values] for shape in shapes]
    for j, parameter in enumerate(plan.parameters):
        for factor in (0.88, 1.14):
            moved = values.copy()
            moved[j] = np.clip(factor * values[j], parameter.low, parameter.high)
            found.append(np.r_[c0, shapes[-1], moved])
    return found
