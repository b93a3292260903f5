"""The layers below the probe, level by level: predicted as bands, measured borders as points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from limbcli.model import Array
from limbcli.reporting.figures.style import INK, QUIET, new_figure, style

_BANDS = {"skin": "#e8b7a0", "fat": "#f3dfa2", "muscle": "#b8656a"}


@dataclass(frozen=True, eq=False)
class LayerPicture:
    """force (n_levels,) N; names of the layers from the skin inward; measured, predicted (n_levels, n_layers)
    mm, measured NaN where not read; deviation mm of a thickness."""

    force: Array
    names: tuple[str, ...]
    measured: Array
    predicted: Array
    deviation: float


def layers_figure(shown: LayerPicture) -> Figure:
    """Left: depth below the probe of every border; right: what measured thicknesses are beyond predicted."""
    with style():
        figure = new_figure(7.6, 3.8)
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        order = np.argsort(shown.force, kind="stable")
        force = shown.force[order]
        below = np.cumsum(shown.predicted[order], axis=1)
        seen = np.cumsum(shown.measured[order], axis=1)
        top = np.zeros(len(force))
        for j, name in enumerate(shown.names):
            left.fill_between(
                force, top, below[:, j], color=_BANDS.get(name, QUIET), lw=0, label=f"{name}, predicted"
            )
            top = below[:, j]
            spread = shown.deviation * np.sqrt(j + 1.0)
            left.errorbar(
                force, seen[:, j], yerr=spread, fmt="o", ms=4, capsize=2, color=INK,
                label="borders, measured (±1 SD)" if j == 0 else None,
            )  # fmt: skip
            gap = shown.measured[order, j] - shown.predicted[order, j]
            right.plot(force, gap, "o-", ms=4, color=_BANDS.get(name, QUIET), mec=INK, label=name)
        left.invert_yaxis()
        left.grid(False)
        left.set(xlabel="probe force [N]", ylabel="below the probe [mm]", title="layers, level by level")
        left.legend(loc="lower left", fontsize=7.5, frameon=True, framealpha=0.85)
        spread = np.sqrt(2.0) * shown.deviation
        right.axhspan(-spread, spread, color=QUIET, alpha=0.18, lw=0, label="±1 SD of two readings")
        right.axhline(0.0, color=QUIET, lw=0.8)
        right.set(xlabel="probe force [N]", ylabel="measured − predicted [mm]", title="thickness")
        right.legend(loc="best", fontsize=7.5)
    return figure
