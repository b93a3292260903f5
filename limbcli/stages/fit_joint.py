"""fit --objective joint: one tissue for all sites, from depth and shear-wave speed together.

Depth is the noisy reading, so it is what the simulation predicts at the measured force;
each level's speed enters by its logarithm; c is free. Only the reference solver can do
it: exact derivatives, and the deformation that the speeds need.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case, Site
from limbcli.errors import FitError, SolveError
from limbcli.inference.adaptive import Intervals
from limbcli.inference.joint import JointProblem, JointTask, SiteData, held_out_error, joint_fit
from limbcli.inference.prediction import Memory
from limbcli.inference.uncertainty import Verdict, correlation, verdict
from limbcli.measurement.indentation import Levels, read_levels
from limbcli.model import Array, LimbModel
from limbcli.progress import SILENT, Progress
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.stages.fit import FitOptions, built_model, initial_stiffness
from limbcli.stages.fit_curves import LawCurve
from limbcli.stages.fit_exports import leave_exports, parameter_rows, write_table
from limbcli.stages.fit_joint_picture import draw_joint
from limbcli.stages.fit_laws import LAWS, FitLaw, law_named
from limbcli.units import kpa_from_mpa

STAGE = "fit-joint"
# What the mesh may add to the force, relative: of tet10 the change under refinement and with
# the penalty (2 to 3 % at 2.5 mm edges); of tet4 what locking leaves at f_kappa 1 (13 %).
GAIN_DEVIATION = {"tet10": 0.03, "tet4": 0.13}
_USUAL_SIZE = 2.5


@dataclass(frozen=True)
class JointOptions:
    """law : one of `fit_laws.LAWS`; compare_laws : all of them, by held-out error

    gain_deviation : of simulated forces, relative (None: by element and edge length)
    """

    law: str = "ogden"
    compare_laws: bool = False
    gain_deviation: float | None = None
    max_solves: int = 16


@dataclass(frozen=True, eq=False)
class Measured:
    """A site as it enters: its model, its levels, c of its own SWE reading."""

    site: Site
    model: LimbModel
    levels: Levels
    c: float


def fit_joint(
    case: Case,
    *,
    out: Path,
    sites: list[str] | None = None,
    joint: JointOptions | None = None,
    options: FitOptions | None = None,
    progress: Progress = SILENT,
) -> StageResult:
    """One set of parameters for the sites named (all), by the joint likelihood.

    Leaves fit-joint.json, a table of levels a site, fit-joint.png, parameters.csv, fit.mat
    and material.feb; with `compare_laws` also laws.csv.

    Raises
    ------
    CaseError, MeasurementError, SolveError, FitError
        As `fit`.
    """
    joint, options = joint or JointOptions(), options or FitOptions()
    law = law_named(joint.law)
    progress.event("stage", name=STAGE, site=None)
    clock = time.perf_counter()
    with open_stage(out, STAGE, subject=case.subject) as writer:
        measured = [_measured(site, out, writer, options) for site in case.selected(sites)]
        names = [law.name] + [each for each in LAWS if joint.compare_laws and each != law.name]
        table = []
        for name in names:
            progress.event("note", text=f"law {name}")
            try:
                problem, found, n_solves = _identify(measured, LAWS[name], joint, options, progress)
            except (SolveError, FitError) as error:
                if name == law.name:
                    raise
                writer.warnings.append(f"the law {name} was not evaluated: {error.what}")
                continue
            table.append(_law_row(LAWS[name], problem, found, n_solves))
            if name == law.name:
                _leave(writer, measured, law, problem, found, n_solves)
        if joint.compare_laws:
            _compare(writer, table)
        writer.data["seconds"] = time.perf_counter() - clock
    assert writer.result is not None
    return writer.result


def _measured(site: Site, out: Path, writer: StageWriter, options: FitOptions) -> Measured:
    model = built_model(site, out, writer, label=site.name)
    levels = read_levels(site.levels)
    stiffness, _ = initial_stiffness(levels, site, options)
    return Measured(site, model, levels, stiffness.c)


# ---------------------------------------------------------------- identification


def _identify(
    measured: Sequence[Measured], law: FitLaw, joint: JointOptions, options: FitOptions, progress: Progress
) -> tuple[JointProblem, Intervals, int]:
    c0 = float(np.exp(np.mean([np.log(each.c) for each in measured])))
    curves, exact, data = [], [], []
    for each in measured:
        speeds = law.has_speed and each.levels.has_swe
        curve = LawCurve(
            each.model, law, c=c0, density_kg_per_m3=each.site.density_kg_per_m3, speeds=speeds,
            progress=progress,
        )  # fmt: skip
        memory = Memory(curve)
        for shape in _first_shapes(law):
            memory(shape, tuple(range(len(shape))))
        curves.append(memory)
        exact.append(curve)
        data.append(site_data(each, curve.depths, joint, speeds=speeds))
    try:
        prior = None if all(len(each.log_speed) for each in data) else _c_prior(measured, options)
        log_speed_0 = [0.5 * float(np.log(c0 * 1e6 / (2 * each.site.density_kg_per_m3))) for each in measured]
        task = JointTask(curves, data, law.shape, c0, log_speed_0, prior)
        starts = [np.r_[c0, shape] for shape in _first_shapes(law)]
        problem, found = joint_fit(task, starts, max_solves=joint.max_solves, progress=progress)
    finally:
        for each_curve in exact:
            each_curve.close()
    return problem, found, sum(each.n_solves for each in curves)


def _first_shapes(law: FitLaw) -> list[Array]:
    """Where to start: the usual values, and each parameter moved by its stride (f_kappa: a tenth)."""
    base = np.array([each.start for each in law.shape])
    shapes = [base]
    for k, parameter in enumerate(law.shape):
        moved = base.copy()
        moved[k] = base[k] / 10.0 if parameter.name == "f_kappa" else min(base[k] * 2.0, parameter.high)
        shapes.append(moved)
    return shapes


def site_data(measured: Measured, knots: Array, joint: JointOptions, *, speeds: bool) -> SiteData:
    """The loading levels of a site with their stated noise."""
    levels, noise = measured.levels, measured.site.noise
    rows = levels.loading & (levels.depth > 0.0) & (levels.force > 0.0)
    seen = levels.loading & np.isfinite(levels.swe_mean_m_per_s) if speeds else np.zeros(len(levels), bool)
    pixels = np.where(np.isfinite(levels.swe_pixels), levels.swe_pixels, np.inf)[seen]
    deviation = np.hypot(noise.swe_level_fraction, noise.swe_pixel_fraction / np.sqrt(pixels))
    return SiteData(
        measured.site.name, knots, levels.force[rows], levels.depth[rows], noise.force, noise.depth,
        np.maximum(levels.force[seen], 0.0), np.log(levels.swe_mean_m_per_s[seen]),
        np.maximum(deviation, 1e-4), gain_deviation(measured.model, joint.gain_deviation),
    )  # fmt: skip


def gain_deviation(model: LimbModel, given: float | None) -> float:
    """Numerical error of the force, relative: stated, or a default by element and edge length."""
    if given is not None:
        return given
    size = float(model.info.get("size_under_probe_mm") or _USUAL_SIZE)
    return GAIN_DEVIATION.get(model.mesh.solid_blocks[0].kind, 0.05) * size / _USUAL_SIZE


def _c_prior(measured: Sequence[Measured], options: FitOptions) -> float:
    """Deviation of ln c where no speed enters: that of one site's level-0 reading."""
    each = measured[0]
    return initial_stiffness(each.levels, each.site, options)[0].log_deviation


# ---------------------------------------------------------------- what is left


def _leave(
    writer: StageWriter, measured: Sequence[Measured], law: FitLaw, problem: JointProblem, found: Intervals,
    n_solves: int,
) -> None:  # fmt: skip
    parameters = parameter_table(problem, found)
    c = float(found.best[0])
    fitted = measured[0].model.with_material("tissue", law.material(c, problem.solved_at(found.best)))
    values = {name: each["value"] for name, each in parameters.items()}
    gains = {
        measured[k].site.name: float(found.best[1 + problem.n_shape + j])
        for j, k in enumerate(problem.gained)
    }
    writer.data.update(
        objective="joint", law=law.name, law_words=law.words, **values,
        kappa_kpa=values["c_kpa"] * values["f_kappa"], parameters=parameters,
        flags={name: each["flag"] for name, each in parameters.items()},
        interval_95={name: [each["low"], each["high"]] for name, each in parameters.items()},
        gains=gains, gain_deviations={each.name: each.gain_deviation for each in problem.task.data},
        chi_square=found.chi_square, n_freedom=found.n_freedom, noise_scale=float(np.sqrt(found.scale)),
        n_solves=n_solves, sites=[each.site.name for each in measured], solver="reference",
    )  # fmt: skip
    rows = parameter_rows("+".join(writer.data["sites"]), law.name, parameters)
    _leave_levels(writer, problem, found)
    leave_exports(writer, rows, writer.data, fitted)
    draw_joint(problem, found, writer)
    for name, each in parameters.items():
        writer.summary.append(f"{name} = {each['value']:.4g}: {each['words']}")
    writer.summary.append(f"chi-square {found.chi_square:.1f} for {found.n_freedom} degrees of freedom")
    for theta in found.unsolved:
        writer.warnings.append(f"no simulation converged at {np.array2string(theta, precision=3)}")


def parameter_table(problem: JointProblem, found: Intervals) -> dict[str, dict[str, Any]]:
    """c in kPa and the shape: value, error, interval, flag and words."""
    n = 1 + problem.n_shape
    logs = found.fit.jacobian * found.fit.theta
    covariance: Array = np.asarray(np.linalg.pinv(logs.T @ logs)[:n, :n] * found.scale)
    rho = correlation(np.asarray(covariance))
    table: dict[str, dict[str, Any]] = {}
    for k, parameter in enumerate(problem.parameters[:n]):
        profile, value = found.profiles[parameter.name], float(found.best[k])
        others = [(problem.parameters[j].name, float(rho[k, j])) for j in range(n) if j != k]
        spoken: Verdict = verdict(parameter, value, profile, influence=True, correlations=others)
        unit = kpa_from_mpa(1.0) if k == 0 else 1.0
        words = spoken.words
        if k == 0:
            words = words.replace(f"{profile.low:.4g} to {profile.high:.4g}",
                                  f"{unit * profile.low:.4g} to {unit * profile.high:.4g} kPa")  # fmt: skip
        table["c_kpa" if k == 0 else parameter.name] = {
            "value": unit * value,
            "standard_error": unit * value * float(np.sqrt(covariance[k, k])),
            "low": None if profile.open_low else unit * profile.low,
            "high": None if profile.open_high else unit * profile.high,
            "flag": spoken.flag, "words": words,
        }  # fmt: skip
    return table


def _leave_levels(writer: StageWriter, problem: JointProblem, found: Intervals) -> None:
    """levels-<site>.csv: measured and predicted depths, and speeds at each force."""
    for k, data in enumerate(problem.task.data):
        seen = problem.predict(k, found.best)
        quantity = ["depth_mm"] * len(data.force) + ["speed_m_per_s"] * len(data.log_speed)
        write_table(
            writer.file(f"levels_{data.name}", f"levels-{data.name}.csv"),
            {
                "force_n": np.r_[data.force, data.speed_force], "quantity": quantity,
                "measured": np.r_[data.depth, np.exp(data.log_speed)],
                "predicted": np.r_[seen.depth, np.exp(seen.log_speed)],
            },
        )  # fmt: skip


def _law_row(law: FitLaw, problem: JointProblem, found: Intervals, n_solves: int) -> dict[str, Any]:
    depth, speed = held_out_error(problem, found)
    shape = dict(zip([each.name for each in law.shape], problem.solved_at(found.best), strict=True))
    return {
        "law": law.name, "n_parameters": 1 + problem.n_shape,
        "held_out_depth_mm": depth,
        "held_out_speed_fraction": speed if np.isfinite(speed) else None,
        "chi_square": found.chi_square, "n_freedom": found.n_freedom,
        "c_kpa": kpa_from_mpa(float(found.best[0])), "shape": shape, "n_solves": n_solves,
    }  # fmt: skip


def _compare(writer: StageWriter, table: list[dict[str, Any]]) -> None:
    """laws.csv, best first: by the error of levels that were left out, never by R2."""
    table.sort(key=lambda row: row["held_out_depth_mm"])
    writer.data["laws"] = table
    writer.data["best_law"] = table[0]["law"]
    columns = [key for key in table[0] if key != "shape"]
    cells = {key: [row[key] if row[key] is not None else "" for row in table] for key in columns}
    cells["shape"] = [
        "; ".join(f"{name} {value:.4g}" for name, value in row["shape"].items()) for row in table
    ]
    write_table(writer.file("laws", "laws.csv"), cells)
    for row in table:
        speed = row["held_out_speed_fraction"]
        writer.summary.append(
            f"{row['law']}: left-out depths missed by {row['held_out_depth_mm']:.3f} mm"
            + (f", speeds by {100 * speed:.1f} %" if speed is not None else "")
        )
