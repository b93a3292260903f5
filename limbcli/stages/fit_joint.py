"""fit --objective joint: one set of tissue parameters for all sites, from depths, wave speeds and layers.

Depth is the noisier reading, so the simulation predicts the depth at the measured force. Speeds enter by
their logarithm, layers by their thickness, and c is free. With layers of fixed stiffness the effect of c on
the force is simulated; otherwise forces are proportional to c. Only the reference solver can be used,
because the fit needs exact derivatives and the deformation from which speeds are predicted.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from limbcli.case import Case, Site
from limbcli.effects.tissue import fibre_direction
from limbcli.errors import CaseError, FitError, MeasurementError, SolveError
from limbcli.fitting.exports import write_mat_file
from limbcli.fitting.fibres import (
    rest_speed,
    stated_deviation,
    write_direction_uncertainty,
    write_orientations,
)
from limbcli.fitting.fitted_cycle import through_cycle, write_cycle
from limbcli.fitting.force_curves import LawCurve
from limbcli.fitting.geometry import NOT_ALLOWED_FOR
from limbcli.fitting.joint_result import law_row, write_comparison, write_joint
from limbcli.fitting.laws import LAWS, FitLaw, first_shapes, law_named
from limbcli.fitting.model_checks import (
    BOUNDARIES,
    ChangedForces,
    allowing_for,
    changed_forces,
    write_boundary_check,
    write_contact_check,
)
from limbcli.fitting.numerical_error import gain_deviation, studied_error
from limbcli.inference.adaptive import Intervals
from limbcli.inference.joint_fit import JointProblem, JointTask, joint_fit
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.site_depth import NO_LAYERS, LayerData, RestSpeed, SiteMeasurement
from limbcli.measurement.indentation import Levels
from limbcli.measurement.speed_noise import mean_speed_deviation
from limbcli.model import Array, LimbModel, Value
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import noted
from limbcli.provenance.requested_options import in_words
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.site_model.layer_readings import LayerReadings, layer_readings
from limbcli.site_model.site_layers import held_layers
from limbcli.site_model.site_levels import levels_of, speed_noise
from limbcli.site_model.site_states import one_state
from limbcli.solvers.material_lines import MaterialLines
from limbcli.stages.fit import FitOptions, built_model, check_numbers, initial_stiffness

STAGE = "fit-joint"
_IN_THE_RESULT = ("law", "compare_laws")  # options that other keys of the result tell
_MOST_SOLVES = 16  # usual number of simulations added for the intervals


@dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """A site's contribution to the fit: its model and its levels.

    c : MPa, given by hand or from the site's own SWE reading; None if there is neither, and c follows from
        other sites
    studied_error : relative numerical error of the force, if `mesh --study` was run
    layers, lines : layer readings, and the layers' borders in the model; None if layers are not used
    """

    site: Site
    model: LimbModel
    levels: Levels
    c: float | None
    studied_error: float | None = None
    layers: LayerReadings | None = None
    lines: MaterialLines | None = None


def fit_joint(
    case: Case, *, out: Path, sites: list[str] | None = None, options: FitOptions | None = None,
    progress: Progress = SILENT,
) -> StageResult:  # fmt: skip
    """Identify one set of parameters for the named sites (default: all) by the joint likelihood.

    Writes fit-joint.json, a table of levels for each site, fit-joint.png, parameters.csv, fit.mat
    and material.feb; with `compare_laws` also laws.csv.

    Raises as `limbcli.fit_joint`.
    """
    options = options or FitOptions()
    law, most = law_named(options.law), options.most_solves(_MOST_SOLVES)
    check_numbers(options)
    progress.event("stage", name=STAGE, site=None)
    clock = time.perf_counter()
    with open_stage(out, STAGE, subject=case.subject) as writer:
        case, selected = noted(case, writer), [site.name for site in case.selected(sites)]
        measured = [_measured(case, case.site(name), out, writer, options) for name in selected]
        for each in measured:
            write_cycle(each.levels, each.site, writer, label=each.site.name)
            check_noise(each.site, speeds=each.levels.has_swe)
        c0 = _start_c(measured, options)
        _report_free(measured, options, writer)
        models = [(each.site.name, each.model) for each in measured]
        have_fibres = any(model.fibres is not None for _, model in models)
        others = [each for each in LAWS if each != law.name and (have_fibres or not LAWS[each].has_fibres)]
        names = [law.name, *(others if options.compare_laws else [])]
        if law.has_fibres:
            write_orientations(models, [each.levels.has_swe for each in measured], writer)
        table = []
        changed: list[list[ChangedForces]] = [[] for _ in measured]  # by the law that was asked for
        for name in names:
            progress.event("note", text=f"law {name}")
            with ExitStack() as curves_open:
                try:
                    curves = _curves(measured, LAWS[name], c0, curves_open, progress)
                    first = _identify(measured, LAWS[name], c0, curves, options, progress)
                    if name == law.name and options.boundary_check:
                        changed = _changed_boundaries(curves, *first, progress)
                    problem, found = allowing_for(changed, *first, max_solves=most, progress=progress)
                except (SolveError, FitError) as error:
                    if name == law.name:
                        raise
                    writer.warnings.append(f"the law {name} was not evaluated: {error.what}")
                    continue
                n_solves = sum(each.n_solves for each in curves)
                table.append(law_row(LAWS[name], problem, found, n_solves))
                if name == law.name:
                    write_joint(writer, models, law, problem, found, n_solves)
                    if law.has_fibres:
                        _check_directions(writer, measured, law, problem, found, out, progress)
                    if options.boundary_check:
                        for each, curve, forces in zip(measured, curves, changed, strict=True):
                            write_boundary_check(forces, curve.depths, writer, site=each.site.name)
                    if options.contact_check:
                        _check_contact(writer, measured, curves, problem, found, progress)
        if options.compare_laws:
            write_comparison(writer, table)
        asked = {**options.requested("joint"), "gain_deviation": options.gain_deviation}
        writer.data["asked"] = {key: each for key, each in asked.items() if key not in _IN_THE_RESULT}
        writer.data["seconds"] = time.perf_counter() - clock
        write_mat_file(writer)
    return writer.result


def _measured(case: Case, site: Site, out: Path, writer: StageWriter, options: FitOptions) -> Measured:
    levels = levels_of(site, options.cycle)
    model = through_cycle(built_model(case, site, out, writer, label=site.name), levels, site)
    error = studied_error(case, site, out, writer, label=f"{site.name}/")
    if case.imaging.assumed and NOT_ALLOWED_FOR not in writer.warnings:
        writer.warnings.append(NOT_ALLOWED_FOR)
    if site.states:
        writer.warnings.append(one_state(site))
    layers, lines = layer_readings(levels, site), None
    if layers is not None:
        try:
            lines = layers.lines(model)
        except MeasurementError as problem:
            writer.warnings.append(f"site {site.name}: layers are not used: {problem.what}")
    is_known = options.c_kpa is not None or np.isfinite(levels.swe_mean_m_per_s[0])
    c = initial_stiffness(levels, site, options)[0].c if is_known else None
    return Measured(
        site=site, model=model, levels=levels, c=c, studied_error=error, layers=layers if lines else None,
        lines=lines,
    )  # fmt: skip


def _report_free(measured: Sequence[Measured], options: FitOptions, writer: StageWriter) -> None:
    """Report that a c given by hand is not held fixed if any site has speeds."""
    given = in_words(
        {key: value for key, value in options.requested().items() if key in ("c_kpa", "c_deviation")}
    )
    if given and any(each.levels.has_swe for each in measured):
        writer.warnings.append(
            f"{given}: the shear-wave speeds determine c, which is free in a joint fit; a value "
            "given by hand is only the start value"
        )


# ---------------------------------------------------------------- identification


def _start_c(measured: Sequence[Measured], options: FitOptions) -> float:
    """Mean of the sites' own values of c (MPa). Raises MeasurementError if no site has one."""
    known = [each.c for each in measured if each.c is not None]
    first = measured[0]
    known = known or [initial_stiffness(first.levels, first.site, options)[0].c]
    return float(np.exp(np.mean(np.log(known))))


def _curves(
    measured: Sequence[Measured], law: FitLaw, c0: float, curves_open: ExitStack, progress: Progress
) -> list[LawCurve]:
    """For each site a curve of forces and speeds by the law, at the common c0, or, with layers of fixed
    stiffness, with c / c0 as one more parameter."""
    curves = []
    for each in measured:
        own = law.along(fibre_direction(each.model))
        own = own.beside_layers() if held_layers(each.model) else own
        curve = LawCurve(
            each.model, own, c=c0, speeds=each.levels.has_swe,
            density_kg_per_m3=each.site.density_kg_per_m3, lines=each.lines, progress=progress,
        )  # fmt: skip
        curves.append(curve)
        curves_open.callback(curve.close)
    return curves


def _identify(
    measured: Sequence[Measured], law: FitLaw, c0: float, exact: Sequence[LawCurve], options: FitOptions,
    progress: Progress,
) -> tuple[JointProblem, Intervals]:  # fmt: skip
    curves, data = [], []
    log_speed_0: list[RestSpeed] = []
    for each, curve in zip(measured, exact, strict=True):
        speeds, density = each.levels.has_swe, each.site.density_kg_per_m3
        log_speed_0.append(
            rest_speed(each.model, law.along(fibre_direction(each.model)), c=c0, density_kg_per_m3=density)
            if law.has_fibres and speeds
            else 0.5 * float(np.log(c0 * 1e6 / (2 * density)))
        )
        memory = SolvedPoints(curve)
        for place in first_shapes(curve.law):
            memory(place, tuple(range(len(place))))
        curves.append(memory)
        given = each.studied_error if options.gain_deviation is None else options.gain_deviation
        gain, layers = gain_deviation(each.model, given), _layer_data(each)
        data.append(site_data(each.site, each.levels, curve.depths, gain, speeds=speeds, layers=layers))
    prior = None  # standard deviation of ln c if no site has speeds: that of the value given by hand
    if not any(len(each.log_speed) for each in data):
        prior = initial_stiffness(measured[0].levels, measured[0].site, options)[0].log_deviation
    beside = [curve.law.has_ratio for curve in exact]
    task = JointTask(
        curves=curves, data=data, shape=law.shape, c0=c0, log_speed_0=log_speed_0, c_deviation=prior,
        beside_layers=beside,
    )  # fmt: skip
    starts = [np.r_[c0, shape] for shape in first_shapes(law)]
    return joint_fit(task, starts, max_solves=options.most_solves(_MOST_SOLVES), progress=progress)


def _check_directions(
    writer: StageWriter, measured: Sequence[Measured], law: FitLaw, problem: JointProblem, found: Intervals,
    out: Path, progress: Progress,
) -> None:  # fmt: skip
    """Effect of turning the fibres by one standard deviation, at every site where that is known."""
    for each in measured:
        deviation = stated_deviation(out, each.site)
        if deviation is not None:
            c, shape = float(found.best[0]), problem.solved_at(found.best)

            def along(direction: Value, each: Measured = each, c: float = c) -> LawCurve:
                density = each.site.density_kg_per_m3
                own = law.along(direction)
                return LawCurve(each.model, own, c=c, density_kg_per_m3=density, progress=progress)

            write_direction_uncertainty(
                along, fibre_direction(each.model), shape, deviation, writer, site=each.site.name
            )


def _changed_boundaries(
    curves: Sequence[LawCurve], problem: JointProblem, found: Intervals, progress: Progress
) -> list[list[ChangedForces]]:
    """Forces of every site's fitted model with other boundaries; their ratios do not depend on c."""
    changed = []
    for k, curve in enumerate(curves):
        place = problem.place(k, found.best)
        try:
            forces = curve(place).values[: len(curve.depths)]
        except SolveError as error:
            changed.append([ChangedForces(each, error=error) for each in BOUNDARIES])
            continue
        again = partial(curve.with_boundary, place)
        changed.append(changed_forces(curve.fitted(place), forces, again, progress=progress))
    return changed


def _check_contact(
    writer: StageWriter, measured: Sequence[Measured], curves: Sequence[LawCurve], problem: JointProblem,
    found: Intervals, progress: Progress,
) -> None:  # fmt: skip
    """Relative effect of a stiffer contact at every site; independent of c."""
    for k, (each, curve) in enumerate(zip(measured, curves, strict=True)):
        place = problem.place(k, found.best)
        try:
            forces = curve(place).values[: len(curve.depths)]
        except SolveError as error:
            writer.warnings.append(f"{each.site.name}: the contact was not checked: {error.what}")
            continue
        write_contact_check(
            each.model.contacts[0].penalty, forces, curve.depths, partial(curve.with_penalty, place),
            writer, site=each.site.name, progress=progress,
        )  # fmt: skip


def site_data(
    site: Site, levels: Levels, knots: Array, gain: float, *, speeds: bool, layers: LayerData = NO_LAYERS
) -> SiteMeasurement:
    """The loading levels of a site with their stated noise; gain : relative numerical error of the force."""
    noise = site.noise
    rows = levels.loading & (levels.depth > 0.0) & (levels.force > 0.0)
    seen = levels.loading & np.isfinite(levels.swe_mean_m_per_s) if speeds else np.zeros(len(levels), bool)
    deviation = mean_speed_deviation(levels, speed_noise(site))[seen]
    return SiteMeasurement(
        name=site.name, knots=knots, force=levels.force[rows], depth=levels.depth[rows],
        force_deviation=noise.force, depth_deviation=noise.depth,
        speed_force=np.maximum(levels.force[seen], 0.0), log_speed=np.log(levels.swe_mean_m_per_s[seen]),
        speed_deviation=np.maximum(deviation, 1e-4),
        gain_deviation=gain, layers=layers,
    )  # fmt: skip


def _layer_data(measured: Measured) -> LayerData:
    """Thicknesses under load, layer by layer; empty if layers are not used."""
    layers, levels = measured.layers, measured.levels
    if layers is None or measured.lines is None:
        return NO_LAYERS
    used = layers.used(levels)
    parts = [np.flatnonzero(used[:, j]) for j in range(layers.n_counted)]
    rows = np.concatenate([np.zeros(0, dtype=np.int64), *parts])
    if not len(rows):
        return NO_LAYERS
    layer = np.repeat(np.arange(layers.n_counted), [len(each) for each in parts])
    thickness = layers.thickness[rows, layer]
    blocks = [layers.covariance(layers.thickness[each, j], j) for j, each in enumerate(parts)]
    force = np.maximum(levels.force[rows], 0.0)
    return LayerData(force, layer, thickness, block_diag(*blocks), measured.lines.rest)


def check_noise(site: Site, *, speeds: bool) -> None:
    """Raise CaseError if a reading that the likelihood weights has no stated noise."""
    noise = site.noise
    none = [] if noise.force > 0 or noise.depth > 0 else ["force_n", "depth_mm"]
    if speeds and not (noise.swe_level_fraction > 0 or noise.swe_pixel_fraction > 0):
        none += ["swe_level_fraction", "swe_pixel_fraction"]
    if none:
        raise CaseError(
            f"site {site.name} states no noise ({', '.join(none)} are 0); a joint fit weights depth "
            "against speed by it",
            where="case.toml, [site.noise]",
            fix="state one standard deviation each, or fit with --objective force",
        )
