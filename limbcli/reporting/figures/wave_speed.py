"""Shear-wave speed of each level against force and against depth, with straight lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limbcli.measurement.regression import Line
from limbcli.model import Array
from limbcli.reporting.figures.style import BLUE, INK, QUIET, new_figure, style


@dataclass(frozen=True, eq=False)
class SpeedReadings:
    """Per level: x (n,), mean speed (n,) m/s, its SD over pixels (n,) m/s or NaN."""

    force: Array
    depth: Array
    mean_m_per_s: Array
    sd_m_per_s: Array


def wave_speed(readings: SpeedReadings, *, against_force: Line | None, against_depth: Line | None) -> Figure:
    """Left: speed over force, as in the papers; right: speed over depth, the better test of a model."""
    with style():
        figure = new_figure(7.4, 3.5)
        left, right = figure.subplots(1, 2, sharey=True)
        _panel(left, readings, readings.force, against_force, "N")
        _panel(right, readings, readings.depth, against_depth, "mm")
        left.set(xlabel="probe force [N]", ylabel="shear-wave speed [m/s]", title="against force")
        right.set(xlabel="indentation depth [mm]", title="against depth")
    return figure


def _panel(axes: Axes, readings: SpeedReadings, x: Array, line: Line | None, unit: str) -> None:
    there = np.isfinite(x) & np.isfinite(readings.mean_m_per_s)
    spread = np.where(np.isfinite(readings.sd_m_per_s), readings.sd_m_per_s, 0.0)
    axes.errorbar(
        x[there],
        readings.mean_m_per_s[there],
        yerr=spread[there] if np.any(spread[there] > 0) else None,
        fmt="o",
        ms=5,
        capsize=3,
        color=INK,
        ecolor=QUIET,
        label="mean ± SD over pixels",
    )
    if line is not None:
        ends = np.array([x[there].min(), x[there].max()])
        axes.plot(ends, line.intercept + line.slope * ends, color=BLUE, label=line_words(line, unit))
    axes.set_ylim(bottom=0.0, top=1.45 * float(np.max((readings.mean_m_per_s + spread)[there])))
    axes.legend(loc="upper left")


def line_words(line: Line, unit: str) -> str:
    """
    >>> line_words(Line(0.051, 2.21, 0.934, None, 12), "N")
    '2.21 m/s + 0.051 m/s per N,  R² = 0.934'
    """
    sign = "+" if line.slope >= 0 else "−"
    r2 = "R² undefined (no variation)" if line.r2 is None else f"R² = {line.r2:.3f}"
    return f"{line.intercept:.2f} m/s {sign} {abs(line.slope):.3f} m/s per {unit},  {r2}"
