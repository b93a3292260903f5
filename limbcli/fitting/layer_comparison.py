"""Comparison of the layer borders (skin, fat, muscle) predicted by the fitted model with those measured.

The fit of the force does not use the layers. A homogeneous tissue displaces its material lines in a definite
way; if the measured layers moved differently, the tissue is not homogeneous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from scipy.special import chdtrc

from limbcli.case import Site
from limbcli.drawing import save_figure
from limbcli.errors import LimbError
from limbcli.fitting.exports import write_table
from limbcli.fitting.predicted_speeds import AT_REST, simulated_rows
from limbcli.measurement.levels import Levels
from limbcli.model import Array, IntArray, LimbModel
from limbcli.reporting.figures.style import INK, MARKERS, QUIET, new_figure, style
from limbcli.results import StageWriter
from limbcli.site_model.layer_readings import LayerReadings, layer_readings
from limbcli.solvers.material_lines import displacements
from limbcli.solvers.solver import Simulation

_FAR = 3.0  # mm, lateral drift of the marked border off the beam above which a warning is given


@dataclass(frozen=True, eq=False)
class PredictedLayers:
    """Indices of the loading levels; thickness (n, n_layers) mm; drift off the beam, mm."""

    levels: IntArray
    thickness: Array
    drift: float


def write_layers(
    fitted: LimbModel, simulation: Simulation, levels: Levels, site: Site, writer: StageWriter
) -> None:
    """Write layers.csv and layers.png if layers were read; a warning if they cannot be predicted."""
    layers = layer_readings(levels, site)
    if layers is None:
        return
    try:
        found = predict_layers(fitted, simulation, levels, layers)
    except LimbError as error:
        writer.warnings.append(f"no layers could be predicted: {error.what}")
        return
    k = found.levels
    columns = {"level": levels.rows[k], "force_n": levels.force[k], "depth_mm": levels.depth[k]}
    for j, name in enumerate(layers.names):
        columns[f"{name}_measured_mm"] = layers.thickness[k, j]
        columns[f"{name}_predicted_mm"] = found.thickness[:, j]
    write_table(writer.file("layers", "layers.csv"), columns)
    picture = layers_figure(
        levels.force[k], layers.names, layers.thickness[k], found.thickness, layers.deviation
    )
    save_figure(picture, writer.file("layers_picture", "layers.png"))
    _report(layers, found, levels, writer)


def predict_layers(
    model: LimbModel, simulation: Simulation, levels: Levels, layers: LayerReadings
) -> PredictedLayers:
    """The simulated layer thicknesses at every loading level; MeasurementError if a border lies outside the
    model's tissue, or no displacements were recorded."""
    numbers, rows = simulated_rows(levels, simulation.probe_depth())
    lines = layers.lines(model)
    u = displacements(lines, simulation)
    at = np.where(rows == AT_REST, 0, rows)
    moved = np.where((rows == AT_REST)[:, None], 0.0, u[at][..., 2])
    return PredictedLayers(numbers, layers.predicted(lines, moved), lines.drift(u))


def _report(layers: LayerReadings, found: PredictedLayers, levels: Levels, writer: StageWriter) -> None:
    """Write data["layers"], a line of the summary, and a warning if the layers contradict the model."""
    used, k = layers.used(levels)[found.levels], found.levels
    deviance, n, reported = 0.0, 0, {}
    for j, name in enumerate(layers.names[: layers.n_counted]):
        rows = used[:, j]
        if not rows.any():
            continue
        off = (layers.thickness[k, j] - found.thickness[:, j])[rows]
        covariance = layers.covariance(found.thickness[rows, j], j)
        deviance, n = deviance + float(off @ np.linalg.solve(covariance, off)), n + int(rows.sum())
        reported[name] = {
            "rms_mm": float(np.sqrt(np.mean(off**2))), "last_mm": float(off[-1]),
            "last_deviations": float(off[-1] / np.sqrt(covariance[-1, -1])),
        }  # fmt: skip
    p = float(chdtrc(n, deviance)) if n else None
    writer.data["layers"] = {
        "names": list(layers.names), "deviation_mm": layers.deviation, "n_readings": n,
        "chi_square": deviance, "p": p, "measured_less_predicted": reported, "drift_mm": found.drift,
    }  # fmt: skip
    parts = ", ".join(f"{name} {each['last_mm']:+.2f} mm" for name, each in reported.items())
    if parts:
        writer.summary.append(
            f"layers, measured minus predicted at the last level: {parts}; "
            f"chi-square {deviance:.1f} for {n} readings"
        )
    if p is not None and p < 0.01:
        writer.warnings.append(
            f"the layers do not move as in this model (p {p:.2g}): a different stiffness of fat or skin, "
            "or another effect in the tissue; `limbcli diagnose` tests which"
        )
    if found.drift > _FAR:
        writer.warnings.append(
            f"the tissue slides up to {found.drift:.1f} mm off the beam: the prediction follows the layers' "
            "own material, but the image shows the material now below the probe"
        )


_HALF_BAND = 0.5  # half width (N) of the bands of a single level
_BANDS = {"skin": "#e8b7a0", "fat": "#f3dfa2", "muscle": "#b8656a"}


def layers_figure(
    force: Array, names: Sequence[str], measured: Array, predicted: Array, deviation: float
) -> Figure:
    """Left: depth of each border below the probe; right: measured minus predicted thickness.

    force : (n_levels,) N; measured, predicted : (n_levels, n_layers) mm, from the skin inwards, measured NaN
        where not read; deviation : mm
    """
    with style():
        figure = new_figure(7.6, 4.3)
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        order = np.argsort(force, kind="stable")
        force, measured, predicted = force[order], measured[order], predicted[order]
        wide = force if len(force) > 1 else force + np.array([-_HALF_BAND, _HALF_BAND])
        below = np.cumsum(predicted, axis=1)
        seen = np.cumsum(measured, axis=1)
        top = np.zeros(len(force))
        for j, name in enumerate(names):
            colour = _BANDS.get(name, QUIET)
            upper, lower = (np.broadcast_to(each, wide.shape) for each in (top, below[:, j]))
            left.fill_between(wide, upper, lower, color=colour, lw=0, label=f"{name}, predicted")
            top = below[:, j]
            left.errorbar(
                force, seen[:, j], yerr=deviation * np.sqrt(j + 1.0), fmt="o", ms=4, capsize=2,
                color=INK, label="borders, measured (±1 SD)" if j == 0 else None,
            )  # fmt: skip
            gap = measured[:, j] - predicted[:, j]
            label = name if np.isfinite(gap).any() else None
            right.plot(force, gap, f"{MARKERS[j]}-", ms=5, color=colour, mec=INK, label=label)
        left.invert_yaxis()
        left.grid(False)
        left.set(xlabel="probe force [N]", ylabel="below the probe [mm]", title="layers, level by level")
        spread = np.sqrt(2.0) * deviation
        right.axhspan(-spread, spread, color=QUIET, alpha=0.18, lw=0, label="±1 SD of two readings")
        right.axhline(0.0, color=QUIET, lw=0.8)
        right.set(xlabel="probe force [N]", ylabel="measured − predicted [mm]", title="thickness")
        for axes in (left, right):
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, fontsize=8)
    return figure
