"""fit --compare-element: fit the same mesh with tet4 and tet10, to show how locking affects f_kappa.

Linear tetrahedra lock: with them f_kappa controls the stiffness of the mesh, not the compressibility of
the tissue. This is shown by the forces at equal parameters, by a sweep of f_kappa, and by both fits.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from limbcli.case import Case
from limbcli.drawing import save_figure
from limbcli.errors import SolveError
from limbcli.fitting.exports import write_table
from limbcli.fitting.fitted_cycle import through_cycle, write_cycle
from limbcli.fitting.force_curves import ReferenceCurve
from limbcli.fitting.options import COMPARISON
from limbcli.inference.prediction import SolvedPoints
from limbcli.inference.two_step_fit import CurveMatch, FittedStep, two_step
from limbcli.meshing.elements import with_element
from limbcli.model import Array
from limbcli.numbers.units import kpa_from_mpa
from limbcli.progress import SILENT, Progress
from limbcli.provenance.chain_inputs import noted
from limbcli.reporting.figures.style import BLUE, INK, QUIET, VERMILION, new_figure, style
from limbcli.results import StageResult, StageWriter, open_stage
from limbcli.site_model.site_levels import levels_of
from limbcli.stages.fit import (
    START,
    FitOptions,
    built_model,
    check_numbers,
    force_depth_data,
    initial_stiffness,
)

STAGE = "fit-elements"
ELEMENTS = ("tet4", "tet10")
SWEEP = (10.0, 100.0, 650.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class ElementFit:
    """Results with one element type: depths (n,) mm, forces (n,) N at the start values and after the fit,
    the last force at each f_kappa of the sweep, and the two steps of the fit.

    linear_force : forces (n,) N with the parameters fitted with tet4, NaN if the model could not be
        solved with them
    """

    element: str
    depths: Array
    start_force: Array
    sweep_force: Array
    steps: tuple[FittedStep, FittedStep]
    fitted_force: Array
    linear_force: Array
    n_unknowns: int


def compare_elements(
    case: Case,
    *,
    out: Path,
    sites: list[str] | None = None,
    options: FitOptions | None = None,
    progress: Progress = SILENT,
) -> list[StageResult]:
    """Fit each site with both element types, using the reference solver.

    Raises as `limbcli.compare_elements`.
    """
    options = options or FitOptions()
    check_numbers(options)
    results = []
    for site in case.selected(sites):
        progress.event("stage", name=STAGE, site=site.name)
        with open_stage(out, STAGE, subject=case.subject, site=site.name) as writer:
            writer.data["asked"] = options.requested(COMPARISON)
            _compare_site(noted(case, writer), site.name, out, writer, options, progress)
        results.append(writer.result)
    return results


def _compare_site(
    case: Case, name: str, out: Path, writer: StageWriter, options: FitOptions, progress: Progress
) -> None:
    site = case.site(name)
    levels = levels_of(site, options.cycle)
    model = through_cycle(built_model(case, site, out, writer), levels, site)
    write_cycle(levels, site, writer)
    stiffness, source = initial_stiffness(levels, site, options)
    data = force_depth_data(levels, site)
    found: list[ElementFit] = []
    for element in ELEMENTS:
        progress.event("note", text=f"{element} of the same mesh")
        same = with_element(model, element)
        curve = ReferenceCurve(same, c=stiffness.c, progress=progress)
        try:
            memory = SolvedPoints(curve)
            start = memory(START, (0, 1)).values
            sweep = [memory(np.array([f_kappa, 2.0]), (0, 1)).values[-1] for f_kappa in SWEEP]
            steps = two_step(
                CurveMatch(memory, curve.depths, data), tolerance=options.tolerance,
                max_iterations=options.max_iterations, progress=progress,
            )  # fmt: skip
            forces = memory(steps[-1].theta).values
            linear = forces if not found else _forces_with(memory, found[0].steps[-1].theta, writer)
        finally:
            curve.close()
        # displacements of the nodes of solid cells that are not fully fixed
        nodes = np.unique(np.concatenate([block.cells.ravel() for block in same.mesh.solid_blocks]))
        held = [same.mesh.node_sets[s.node_set] for s in same.supports if len(s.dofs) == 3]
        free = np.setdiff1d(nodes, np.concatenate(held) if held else np.zeros(0, np.int64))
        found.append(ElementFit(
            element=element, depths=curve.depths, start_force=start, sweep_force=np.array(sweep), steps=steps,
            fitted_force=forces, linear_force=linear, n_unknowns=3 * len(free),
        ))  # fmt: skip
    _write(writer, found, kpa_from_mpa(stiffness.c), source, data.depth, data.force)


def _forces_with(curve: SolvedPoints, theta: Array, writer: StageWriter) -> Array:
    """Forces at these parameters, or NaN and a warning if the model cannot be solved with them."""
    try:
        return curve(theta).values
    except SolveError as error:
        writer.warnings.append(f"tet10 could not be solved with the parameters of tet4: {error.what}")
        return np.full(len(curve(START).values), np.nan)


def _write(
    writer: StageWriter, found: list[ElementFit], c_kpa: float, source: str, depth: Array, force: Array
) -> None:
    linear, quadratic = found
    ratio = linear.start_force / quadratic.start_force
    share = float(quadratic.linear_force[-1] / linear.fitted_force[-1])
    rows = [_row(each) for each in found]
    rise = {each.element: float(each.sweep_force[-1] / each.sweep_force[0]) for each in found}
    writer.data.update(
        c_kpa=c_kpa, c_source=source, elements={row["element"]: row for row in rows},
        force_ratio_tet4_over_tet10=float(ratio[-1]),
        tet10_share_of_force_with_tet4_parameters=share,
        force_rise_f_kappa_10_to_650=rise,
        f_kappa_ratio_tet10_over_tet4=rows[1]["f_kappa"] / rows[0]["f_kappa"],
    )  # fmt: skip
    write_table(
        writer.file("forces", "forces.csv"),
        {
            "depth_mm": linear.depths,
            **{f"{each.element}_start_n": each.start_force for each in found},
            **{f"{each.element}_fitted_n": each.fitted_force for each in found},
            "tet10_with_tet4_parameters_n": quadratic.linear_force,
        },
    )
    columns = ("element", "n_unknowns", "f_kappa", "m", "f_kappa_mooney_rivlin", "r2", "rmse_n")
    write_table(writer.file("table", "elements.csv"), {name: [row[name] for row in rows] for name in columns})
    _draw(writer, found, depth, force)
    writer.summary += [
        f"{row['element']}: f_kappa {row['f_kappa']:.4g}, m {row['m']:.4g}, RMSE {row['rmse_n']:.3f} N "
        f"({row['n_unknowns']} unknowns)"
        for row in rows
    ]
    writer.summary.append(
        f"at f_kappa 100 and m 2 tet4 is {ratio[-1]:.2f} times as stiff as tet10 at the last level"
    )
    if np.isfinite(share):
        writer.summary.append(
            f"with the parameters fitted with tet4, tet10 gives {share:.2f} times the last "
            "force: the rest was due to the mesh"
        )
    writer.summary.append(
        f"f_kappa 10 to 650 raises the last force {rise['tet4']:.2f} times with tet4, "
        f"{rise['tet10']:.2f} times with tet10: this part of tet4's f_kappa is due to the mesh"
    )


def _row(each: ElementFit) -> dict[str, Any]:
    first, last = each.steps
    return {
        "element": each.element, "n_unknowns": each.n_unknowns,
        "f_kappa": float(last.theta[0]), "m": float(last.theta[1]),
        "f_kappa_mooney_rivlin": float(first.theta[0]), "r2": last.r2, "rmse_n": last.rmse,
        "sweep_f_kappa": list(SWEEP), "sweep_last_force_n": [float(x) for x in each.sweep_force],
    }  # fmt: skip


def _draw(writer: StageWriter, found: list[ElementFit], depth: Array, force: Array) -> None:
    """Draw elements.png: forces at equal parameters and after each fit; the last force against f_kappa."""
    with style():
        figure = new_figure(7.6, 4.4)
        left, right = figure.subplots(1, 2)
        left.plot(depth, force, "o", ms=4, color=INK, label="measured")
        for each, colour in zip(found, (BLUE, VERMILION), strict=True):
            depths = np.r_[0.0, each.depths]
            left.plot(
                depths,
                np.r_[0.0, each.start_force],
                ":",
                color=colour,
                label=rf"{each.element}, $f_\kappa$ = 100, m = 2",
            )
            left.plot(depths, np.r_[0.0, each.fitted_force], color=colour, label=f"{each.element}, fitted")
            if each.element == "tet10":
                with_tet4 = np.r_[0.0, each.linear_force]
                left.plot(depths, with_tet4, "--", color=colour, label="tet10, parameters of tet4")
            right.plot(SWEEP, each.sweep_force / each.sweep_force[0], "o-", color=colour, label=each.element)
        right.axhline(1.0, color=QUIET, lw=0.8)
        left.set(xlabel="indentation depth [mm]", ylabel="probe force [N]")
        right.set(xlabel=r"$f_\kappa$ [–]", ylabel=r"last force over that at $f_\kappa$ 10 [–]", xscale="log")
        right.set_xticks(SWEEP, [f"{each:g}" for each in SWEEP])
        right.minorticks_off()
        for axes in (left, right):
            axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.2))
        save_figure(figure, writer.file("picture", "elements.png"))
