"""The outputs of the joint fit: fit-joint.json, tables, exports, and the comparison of laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from limbcli.effects.tissue import fibre_direction
from limbcli.fitting.exports import parameter_rows, write_exports, write_table
from limbcli.fitting.fibres import write_moduli
from limbcli.fitting.joint_picture import draw_joint
from limbcli.fitting.laws import FIBRE_F_KAPPA, LOCKING, FitLaw
from limbcli.inference.adaptive import Intervals
from limbcli.inference.agreement import chi_square_agreement
from limbcli.inference.identifiability import are_determined, correlation, verdict
from limbcli.inference.joint_fit import JointProblem, JointTask, held_out_error
from limbcli.inference.likelihood import Likelihood
from limbcli.inference.site_depth import SiteMeasurement, SitePrediction
from limbcli.measurement.levels import LAYERS
from limbcli.model import LimbModel
from limbcli.numbers.interval_limits import Flag
from limbcli.numbers.significant_digits import short
from limbcli.numbers.units import kpa_from_mpa
from limbcli.reporting.headline import headline
from limbcli.results import StageWriter


def write_joint(
    writer: StageWriter, measured: Sequence[tuple[str, LimbModel]], law: FitLaw, problem: JointProblem,
    found: Intervals, n_solves: int,
) -> None:  # fmt: skip
    """Write fit-joint.json, the levels of each site, exports and figures; `measured`: (site name, model)."""
    parameters = parameter_table(problem, found)
    judge_given_c(parameters["c_kpa"], problem.task, found.scale)
    c = float(found.best[0])
    model = measured[0][1]
    own = law.along(fibre_direction(model))
    fitted = model.with_material("tissue", own.material(c, problem.solved_at(found.best)))
    values = {name: each["value"] for name, each in parameters.items()}
    gains = {measured[k][0]: float(found.best[1 + problem.n_shape + j]) for j, k in enumerate(problem.gained)}
    write_numbers(writer, "joint", law, parameters, found, [each for _, each in measured], n_solves)
    writer.data.update(
        kappa_kpa=values["c_kpa"] * {**values, **law.fixed}["f_kappa"], sites=[name for name, _ in measured],
        gains=gains, gain_deviations={each.name: each.gain_deviation for each in problem.task.data},
    )  # fmt: skip
    rows = parameter_rows("+".join(writer.data["sites"]), law.name, parameters)
    seen = [each.predict(found.best) for each in problem.blocks]
    write_level_table(writer, problem.task.data, seen)
    write_exports(writer, rows, fitted)
    draw_joint(problem.task.data, seen, found, writer)
    notes = write_moduli(values["c_kpa"], values["fibre_shear"], writer) if law.has_fibres else []
    n_layers = sum(len(each.layers) for each in problem.task.data)
    writer.data["n_layer_readings"] = n_layers
    if n_layers:
        notes.append(f"{n_layers} readings of layers entered")
    report_fit(writer, law, parameters, found, notes)


def write_numbers(
    writer: StageWriter, objective: str, law: FitLaw, parameters: Mapping[str, Mapping[str, Any]],
    found: Intervals, models: Sequence[LimbModel], n_solves: int,
) -> None:  # fmt: skip
    """Write what the fits of sites and of states have in common; `parameters`: of `parameter_table`."""
    writer.data.update(
        objective=objective, law=law.name, law_words=law.words,
        **{name: each["value"] for name, each in parameters.items()}, **law.fixed, parameters=parameters,
        flags={name: each["flag"] for name, each in parameters.items()},
        interval_95={name: [each["low"], each["high"]] for name, each in parameters.items()},
        chi_square=found.chi_square, n_freedom=found.n_freedom, noise_scale=float(np.sqrt(found.scale)),
        element=elements_of(models),
        n_solves=n_solves, solver="reference",
    )  # fmt: skip


def elements_of(models: Sequence[LimbModel]) -> str:
    """The kinds of solid elements in these models, joined by "+"."""
    return "+".join(sorted({block.kind for each in models for block in each.mesh.solid_blocks}))


def report_fit(
    writer: StageWriter, law: FitLaw, parameters: Mapping[str, Mapping[str, Any]], found: Intervals,
    notes: Sequence[str],
) -> None:  # fmt: skip
    """Summary and warnings that the fits of sites and of states have in common, with the `notes` of one."""
    for name, each in parameters.items():
        writer.summary.append(f"{name}: {each['headline']}; {each['words']}")
    writer.summary += notes
    writer.summary.append(f"chi-square {found.chi_square:.1f} for {found.n_freedom} degrees of freedom")
    _warn_poor(found, writer)
    _warn_locking(law, writer)
    for theta in found.unsolved:
        writer.warnings.append(f"no simulation converged at {np.array2string(theta, precision=3)}")


def _warn_poor(found: Intervals, writer: StageWriter) -> None:
    """Write `agreement`; a bad one is also the first warning."""
    met = chi_square_agreement(found.chi_square, found.n_freedom)
    writer.data["agreement"] = vars(met)
    writer.summary.insert(0, f"{met.state}: {met.words}")
    if met.state != "bad":
        return
    writer.warnings.insert(
        0,
        f"the fit does not reproduce the data: chi-square {found.chi_square:.0f} for {found.n_freedom} "
        f"degrees of freedom (probability {met.chance:.1g} under the stated noise). The parameters describe "
        "the nearest curves, not the tissue: check the figures, the noise of the case, and what `limbcli "
        "diagnose` finds missing",
    )


def _warn_locking(law: FitLaw, writer: StageWriter) -> None:
    """Warn that parameters found with linear tetrahedra (`element` of the result) hold on that mesh only."""
    if "tet4" not in writer.data["element"]:
        return
    if not law.fixed:
        writer.warnings.append(LOCKING)
        return
    writer.warnings.append(
        f"linear tetrahedra lock: at the f_kappa of {FIBRE_F_KAPPA:g} that this law assumes their forces are "
        "too high, and c, m and the fibres compensate for it; tet10 elements do not lock"
    )


def parameter_table(problem: Likelihood, found: Intervals) -> dict[str, dict[str, Any]]:
    """Table of c (kPa) and the other profiled parameters: value, error, interval, flag and words."""
    n = len(problem.profiled)
    logs = found.fit.jacobian * found.fit.theta
    rows = np.linalg.pinv(logs)[:n]
    covariance = rows @ rows.T * found.scale
    silent = ~are_determined(logs)[:n]
    covariance[silent], covariance[:, silent] = np.nan, np.nan
    rho = np.nan_to_num(correlation(covariance))
    table: dict[str, dict[str, Any]] = {}
    for k, parameter in enumerate(problem.parameters[:n]):
        profile, value = found.profiles[parameter.name], float(found.best[k])
        others = [(problem.parameters[j].name, float(rho[k, j])) for j in range(n) if j != k]
        unit, named = (kpa_from_mpa(1.0), "kPa") if k == 0 else (1.0, "")
        own = replace(
            parameter, start=unit * parameter.start, low=unit * parameter.low, high=unit * parameter.high
        )
        seen = replace(profile, low=unit * profile.low, high=unit * profile.high)
        spoken = verdict(own, unit * value, seen, influence=True, correlations=others, unit=named)
        low, high = seen.limits
        table["c_kpa" if k == 0 else parameter.name] = {
            "value": unit * value,
            "headline": str(headline(unit * value, low, high, spoken.flag, unit=named)),
            "standard_error": unit * value * float(np.sqrt(covariance[k, k])),
            "low": low, "high": high, "flag": spoken.flag, "words": spoken.words,
        }  # fmt: skip
    return table


def judge_given_c(c: dict[str, Any], task: JointTask, scale: float) -> None:
    """Flag c (its row, changed in place) as fixed if it was given and the data determine it less precisely
    than that; scale : factor on the variances of noise and of the given c"""
    if task.c_deviation is None or c["standard_error"] < np.sqrt(0.5 * scale) * task.c_deviation * c["value"]:
        return
    given = f"{short(kpa_from_mpa(task.c0), 4)} kPa, one deviation {short(100 * task.c_deviation, 2)} %"
    c["flag"] = Flag.FIXED
    c["words"] = f"c is what was given ({given}): the data determine it less precisely than that."
    c["headline"] = str(headline(c["value"], c["low"], c["high"], c["flag"], unit="kPa"))


def write_level_table(
    writer: StageWriter, several: Sequence[SiteMeasurement], predicted: Sequence[SitePrediction]
) -> None:
    """Write levels-<site>.csv: measured and predicted depths, speeds and layers at each force."""
    for data, seen in zip(several, predicted, strict=True):
        quantity = ["depth_mm"] * len(data.force) + ["speed_m_per_s"] * len(data.log_speed)
        quantity += [f"{LAYERS[j]}_mm" for j in data.layers.layer]
        write_table(
            writer.file(f"levels_{data.name}", f"levels-{data.name}.csv"),
            {
                "force_n": np.r_[data.force, data.speed_force, data.layers.force], "quantity": quantity,
                "measured": np.r_[data.depth, np.exp(data.log_speed), data.layers.thickness],
                "predicted": np.r_[seen.depth, np.exp(seen.log_speed), seen.layers],
            },
        )  # fmt: skip


def law_row(law: FitLaw, problem: JointProblem, found: Intervals, n_solves: int) -> dict[str, Any]:
    """One law's row of the comparison: its error on left-out levels, and its parameters."""
    depth, speed = held_out_error(problem, found)
    shape = dict(zip([each.name for each in law.shape], problem.solved_at(found.best), strict=True))
    return {
        "law": law.name, "n_parameters": 1 + problem.n_shape,
        "held_out_depth_mm": depth,
        "held_out_speed_fraction": speed if np.isfinite(speed) else None,
        "chi_square": found.chi_square, "n_freedom": found.n_freedom,
        "c_kpa": kpa_from_mpa(float(found.best[0])), "shape": shape, "n_solves": n_solves,
    }  # fmt: skip


def write_comparison(writer: StageWriter, table: list[dict[str, Any]]) -> None:
    """Write laws.csv, best first, ranked by the error on left-out levels and never by R2."""
    table.sort(key=lambda row: row["held_out_depth_mm"])
    writer.data["laws"] = table
    writer.data["best_law"] = table[0]["law"]
    columns = [key for key in table[0] if key != "shape"]
    cells = {key: [row[key] for row in table] for key in columns}
    cells["shape"] = [
        "; ".join(f"{name} {value:.4g}" for name, value in row["shape"].items()) for row in table
    ]
    write_table(writer.file("laws", "laws.csv"), cells)
    for row in table:
        speed = row["held_out_speed_fraction"]
        writer.summary.append(
            f"{row['law']}: held-out depth error {row['held_out_depth_mm']:.3f} mm"
            + (f", speeds by {100 * speed:.1f} %" if speed is not None else "")
        )
