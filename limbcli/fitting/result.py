"""The outputs of `fit`: the numbers of fit.json, the curves, the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Site
from limbcli.drawing import save_figure
from limbcli.files.plain_text import write_rows
from limbcli.fitting.exports import parameter_rows, write_exports
from limbcli.fitting.joint_picture import draw_profiles
from limbcli.fitting.joint_result import elements_of
from limbcli.fitting.laws import LOCKING
from limbcli.fitting.table import NAMES, Identified, counted_deviation, step_agreement, step_table
from limbcli.inference.adaptive import Intervals
from limbcli.inference.agreement import ORDER, speed_agreement, tissue_agreement
from limbcli.inference.geometry_uncertainty import ends
from limbcli.inference.monotone_interpolation import pchip_sample
from limbcli.inference.two_step_fit import MOONEY_RIVLIN, OGDEN, sensitivities
from limbcli.model import LimbModel
from limbcli.numbers.interval_limits import Flag
from limbcli.numbers.modes import at_depths
from limbcli.numbers.significant_digits import short
from limbcli.numbers.units import kpa_from_mpa
from limbcli.reporting.figures.force_depth import MeasuredCurve, SimulatedCurve, force_depth
from limbcli.reporting.headline import headline
from limbcli.results import StageWriter
from limbcli.solvers.solver import Simulation

_FINE = 120
_TOP = (
    "c_kpa", "f_kappa", "kappa_kpa", "m", "r2", "rmse_n",
    "standard_error", "interval_95", "flags", "words",
)  # fmt: skip


def write_result(
    found: Identified, fitted: LimbModel, simulation: Simulation, writer: StageWriter, site: Site, *,
    seconds: float,
) -> None:  # fmt: skip
    """Write fit.json, curves.csv and the figures."""
    tables = {step.name: step_table(found, k) for k, step in enumerate(found.steps)}
    last = tables[OGDEN]
    writer.data.update({key: last[key] for key in _TOP})
    writer.data.update(
        law="ogden type", objective="force", element=elements_of([fitted]),
        solver=simulation.solver, solver_version=simulation.version,
        linear_solver=simulation.linear_solver, c_source=found.c_source,
        c_deviation_fraction=found.stiffness.log_deviation,
        numerical_error_fraction=found.stiffness.gain_deviation,
        correlation=last["correlations"], steps=tables,
        n_iterations=sum(step.fit.n_iterations for step in found.steps),
        n_solves=sum(step.n_solves for step in found.steps) + 1,
        n_interval_solves=sum(each.n_solves for each in found.intervals or ()),
        seconds=seconds, cold_solve_seconds=found.cold_seconds,
        identification_seconds=found.cold_seconds + sum(step.seconds for step in found.steps),
        n_levels=len(found.data.force),
        noise={"force_n": site.noise.force, "depth_mm": site.noise.depth,
               "swe_level_fraction": site.noise.swe_level_fraction,
               "swe_pixel_fraction": site.noise.swe_pixel_fraction, "source": site.noise.source},
        variance="force residual: sigma_F^2 + (dF/dd sigma_d)^2",
    )  # fmt: skip
    if found.intervals:
        best = found.intervals[-1]
        writer.data["chi_square"], writer.data["n_freedom"] = best.chi_square, best.n_freedom
        writer.data["noise_scale"] = float(np.sqrt(best.scale))
        writer.data["most_likely"] = dict(
            zip(("c_kpa", *NAMES), (kpa_from_mpa(float(best.best[0])), *best.best[1:3]), strict=True)
        )
        for theta in best.unsolved:
            writer.warnings.append(
                f"no simulation converged at f_kappa {theta[0]:.3g}, m {theta[1]:.3g}: "
                "the intervals stop before it and are marked open there"
            )
    write_curves(found, writer.file("curves", "curves.csv"))
    rows = [
        row for name, each in tables.items() for row in parameter_rows(site.name, name, each["parameters"])
    ]
    write_exports(writer, rows, fitted)
    draw_fit(found, site, writer)
    summarise(found, last, writer)


def write_widening(of_noise: Intervals, writer: StageWriter) -> None:
    """Write `interval_95_noise`, of the measurement's noise alone, and a line of the summary."""
    before = ends(of_noise)
    writer.data["interval_95_noise"] = before
    if words := widening(before):
        writer.summary.append(words)


def widening(before: Mapping[str, Sequence[float | None]]) -> str:
    """Sentence on the intervals without the uncertainty of geometry and boundaries; empty if all are open.

    >>> widening({"f_kappa": [None, 90.0], "m": [4.0, 5.0]})
    'with noise and mesh alone the 95 % interval would be 4 to 5 for m'
    >>> widening({"m": [4.0, None]})
    ''
    """
    parts = [
        f"{short(low)} to {short(high)} for {name}"
        for name, (low, high) in before.items() if low is not None and high is not None
    ]  # fmt: skip
    return f"with noise and mesh alone the 95 % interval would be {', '.join(parts)}" if parts else ""


def write_curves(found: Identified, path: Path) -> None:
    """Write curves.csv: a row for every level (also where two have the same depth) and rows in between,
    with the simulated curves of the initial guess and of the steps."""
    measured = found.data.depth
    between = np.setdiff1d(np.linspace(0.0, found.knots[-1], _FINE), measured)
    depths = np.r_[measured, between]
    forces = [f"{each:.6g}" for each in found.data.force] + [""] * len(between)
    thetas = [found.start, *(step.theta for step in found.steps)]
    curves = [found.sample(theta, depths).values for theta in thetas]
    write_rows(
        path, ("depth_mm", "measured_n", "start_n", f"{MOONEY_RIVLIN}_n", f"{OGDEN}_n"),
        ([f"{depths[k]:.6g}", forces[k], *(f"{each[k]:.6g}" for each in curves)]
         for k in np.argsort(depths, kind="stable")),
    )  # fmt: skip


def draw_fit(found: Identified, site: Site, writer: StageWriter) -> None:
    """Draw fit.png (measured levels, curves, residuals) and, if profiles were computed, profiles.png."""
    depths = np.linspace(0.0, found.knots[-1], _FINE)
    labels = ("start (f_κ = 100, m = 2)", "Mooney-Rivlin type (m = 2)", "Ogden type")
    thetas = [found.start, *(step.theta for step in found.steps)]
    curves = [
        SimulatedCurve(key, label, depths, found.sample(theta, depths).values)
        for key, label, theta in zip(("start", MOONEY_RIVLIN, OGDEN), labels, thetas, strict=True)
    ]
    last = found.steps[-1]
    measured = MeasuredCurve(
        found.data.depth, found.data.force, site.noise.depth, site.noise.force,
        counted=(found.data.loaded_depth, counted_deviation(found, last)),
    )  # fmt: skip
    save_figure(force_depth(measured, curves), writer.file("picture", "fit.png"))
    if found.intervals:
        draw_profiles(found.intervals[-1], found.steps[-1].theta, writer)


def summarise(found: Identified, last: Mapping[str, Any], writer: StageWriter) -> None:
    """Write the summary, `misfit` and the force's `agreement`; last : table of the last step"""
    met, poor = step_agreement(found, found.steps[-1]), ""
    if met.state == "bad":
        poor = met.words
        writer.warnings.insert(0, f"poor fit: {poor}. {_POOR}")
    writer.data["misfit"] = {
        "poor": bool(poor), "noise_rms_n": met.noise_rms or 0.0, "times_noise": met.times_noise, "words": poor
    }  # fmt: skip
    writer.data["agreement"] = {
        "state": met.state,
        "force": {
            **vars(met), "depths_mm": found.data.loaded_depth,
            "counted_noise_n": counted_deviation(found, found.steps[-1]),
        },
    }  # fmt: skip
    at_lower_bound = [name for name in NAMES if last["parameters"][name]["bound"] == "lower"]
    tissue = tissue_agreement(last["parameters"]["f_kappa"]["high"], at_lower_bound)
    if tissue is not None:
        writer.data["agreement"]["tissue"] = vars(tissue)
        if tissue.state == "bad":
            writer.warnings.insert(0, f"poor fit: {tissue.words}")
    writer.summary.append(f"c = {last['c_kpa']:.2f} kPa, held fixed ({found.c_source})")
    for name in NAMES:
        computed = name in last["interval_95"]
        writer.summary.append(_estimated(name, last["parameters"][name], computed=computed))
    first = writer.data["steps"][MOONEY_RIVLIN]
    writer.summary.append(
        f"R2 {last['r2']:.4f}, RMSE {last['rmse_n']:.3f} N (with m = 2: f_kappa "
        f"{first['parameters']['f_kappa']['headline']}, R2 {first['r2']:.4f}); "
        f"{_effort(writer.data)}"
    )
    error = 100 * found.stiffness.gain_deviation
    writer.summary.append(f"counted as uncertainty of the simulated force: {short(error, 2)} % from the mesh")
    if "tet4" in writer.data["element"]:
        writer.warnings.append(LOCKING)
    for name in NAMES:
        if last["flags"][name] not in (Flag.IDENTIFIED, Flag.FIXED):
            writer.warnings.append(last["words"][name])


def _effort(data: Mapping[str, Any]) -> str:
    """
    >>> _effort({"n_iterations": 6, "n_solves": 7, "n_interval_solves": 18})
    '6 iterations, 25 solves (18 of them for the intervals)'
    >>> _effort({"n_iterations": 6, "n_solves": 7, "n_interval_solves": 0})
    '6 iterations, 7 solves'
    """
    more = data["n_interval_solves"]
    of_them = f" ({more} of them for the intervals)" if more else ""
    return f"{data['n_iterations']} iterations, {data['n_solves'] + more} solves{of_them}"


def write_agreement(found: Identified, writer: StageWriter) -> None:
    """Complete `agreement` by the speeds, if predicted; its parts begin the summary, worst first."""
    told = writer.data["agreement"]
    speeds = writer.data.get("swe")
    if speeds is not None and len(speeds["loaded_measured_m_per_s"]):
        met = speed_agreement(
            np.array(speeds["loaded_predicted_m_per_s"]), np.array(speeds["loaded_measured_m_per_s"]),
            level_fraction=writer.data["noise"]["swe_level_fraction"],
            c_deviation=found.stiffness.force_deviation,
        )  # fmt: skip
        told["speeds"] = vars(met)
    parts = [told[name] for name in ("tissue", "force", "speeds") if name in told]
    parts.sort(key=lambda each: ORDER.index(each["state"]), reverse=True)
    told["state"] = parts[0]["state"]
    writer.summary[:0] = [f"{each['state']}: {each['words']}" for each in parts]


_POOR = (
    "The parameters describe the nearest curve, not the tissue: check fit.png, the units and "
    "signs of levels.csv, and what `limbcli diagnose` finds missing"
)


def _estimated(name: str, estimate: Mapping[str, Any], *, computed: bool) -> str:
    """
    >>> estimate = {"value": 15.2, "low": 14.0, "high": 16.5, "flag": "identified", "bound": ""}
    >>> _estimated("f_kappa", estimate, computed=True)
    'f_kappa = 15.2 (95 %: 14 to 16.5): identified'
    >>> _estimated("m", estimate | {"low": 3.3, "high": None, "flag": "at bound"}, computed=True)
    'm: above 3.30 (95 %): at bound'
    """
    low, high, flag = estimate["low"], estimate["high"], estimate["flag"]
    found = headline(estimate["value"], low, high, flag, bound=estimate["bound"], computed=computed)
    if not found.is_number:
        return f"{name}: {found}{' (95 %)' if (low, high) != (None, None) else ''}: {flag}"
    if found.remark:
        return f"{name} = {found}: {flag}"
    interval = "no interval" if None in (low, high) else f"95 %: {short(low)} to {short(high)}"
    return f"{name} = {found} ({interval}): {flag}"


def write_tissue_force(found: Identified, contact_penalty: float, writer: StageWriter) -> None:
    """Write `tissue_force`: the fitted forces at the loaded levels, their noise, and all simulations, from
    which the limb's stiffness field takes which f_kappa and m belong together.

    Nothing is written where the case states no noise, or the simulations lack derivatives.
    """
    step = found.steps[-1]
    noise = counted_deviation(found, step)
    solved = [each for each in found.curve.solved if each[1].has((0, 1))]
    if not noise.any() or not solved:
        return
    depths = found.data.loaded_depth
    errors = [np.full(len(depths), found.gain_of(step))]
    if found.modes is not None:
        errors += list(at_depths(found.modes, found.knots, depths).T)
    knots, forces, slopes = np.r_[0.0, found.knots], [], []
    for theta, answer in solved:
        assert answer.jacobian is not None
        sample = pchip_sample(knots, np.r_[0.0, answer.values], depths)
        forces.append(sample.values)
        slopes.append(sample.weights[:, 1:] @ (answer.jacobian * theta) / sample.values[:, None])
    scale = found.intervals[-1].scale if found.intervals else 1.0
    writer.data["tissue_force"] = {
        "depths_mm": depths,
        "fitted_n": sensitivities(found, step.theta).values,
        "noise_n": np.sqrt(scale) * noise,
        "model_errors_of_ln": np.array(errors),
        "c_share": found.stiffness.share_at_levels(found),
        "contact_penalty": contact_penalty,
        "simulated": {
            "f_kappa": [float(theta[0]) for theta, _ in solved],
            "m": [float(theta[1]) for theta, _ in solved],
            "forces_n": np.array(forces),
            "slopes_of_ln": np.array(slopes),
        },
    }
