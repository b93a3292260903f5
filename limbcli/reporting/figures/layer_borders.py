"""Layers below the probe, level by level: predicted as bands, measured borders as points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from limbcli.model import Array
from limbcli.reporting.figures.style import INK, MARKERS, QUIET, new_figure, style

_HALF_BAND = 0.5  # half width (N) of the bands of a single level
_BANDS = {"skin": "#e8b7a0", "fat": "#f3dfa2", "muscle": "#b8656a"}


@dataclass(frozen=True, eq=False)
class LayerPicture:
    """Layers at each level.

    force : (n_levels,) N
    names : of the layers, from the skin inwards
    measured, predicted : (n_levels, n_layers) mm; measured is NaN where not read
    deviation : standard deviation of a thickness (mm)
    """

    force: Array
    names: tuple[str, ...]
    measured: Array
    predicted: Array
    deviation: float


def layers_figure(shown: LayerPicture) -> Figure:
    """Left: depth of each border below the probe; right: measured minus predicted thickness."""
    with style():
        figure = new_figure(7.6, 4.3)
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        order = np.argsort(shown.force, kind="stable")
        force = shown.force[order]
        wide = force if len(force) > 1 else force + np.array([-_HALF_BAND, _HALF_BAND])
        below = np.cumsum(shown.predicted[order], axis=1)
        seen = np.cumsum(shown.measured[order], axis=1)
        top = np.zeros(len(force))
        for j, name in enumerate(shown.names):
            colour = _BANDS.get(name, QUIET)
            upper, lower = (np.broadcast_to(each, wide.shape) for each in (top, below[:, j]))
            left.fill_between(wide, upper, lower, color=colour, lw=0, label=f"{name}, predicted")
            top = below[:, j]
            left.errorbar(
                force, seen[:, j], yerr=shown.deviation * np.sqrt(j + 1.0), fmt="o", ms=4, capsize=2,
                color=INK, label="borders, measured (±1 SD)" if j == 0 else None,
            )  # fmt: skip
            gap = shown.measured[order, j] - shown.predicted[order, j]
            right.plot(
                force,
                gap,
                f"{MARKERS[j]}-",
                ms=5,
                color=colour,
                mec=INK,
                label=name if np.isfinite(gap).any() else None,
            )
        left.invert_yaxis()
        left.grid(False)
        left.set(xlabel="probe force [N]", ylabel="below the probe [mm]", title="layers, level by level")
        spread = np.sqrt(2.0) * shown.deviation
        right.axhspan(-spread, spread, color=QUIET, alpha=0.18, lw=0, label="±1 SD of two readings")
        right.axhline(0.0, color=QUIET, lw=0.8)
        right.set(xlabel="probe force [N]", ylabel="measured − predicted [mm]", title="thickness")
        for axes in (left, right):
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, fontsize=8)
    return figure
