"""Shear-wave speed of each level against force and against depth, with regression lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limbcli.measurement.regression import Line
from limbcli.model import Array
from limbcli.reporting.figures.style import BLUE, INK, QUIET, VERMILION, new_figure, style


@dataclass(frozen=True, eq=False)
class SpeedReadings:
    """Readings by level: x (n,), mean speed (n,) m/s, its SD over pixels (n,) m/s or NaN."""

    force: Array
    depth: Array
    mean_m_per_s: Array
    sd_m_per_s: Array


@dataclass(frozen=True, eq=False)
class PredictedSpeeds:
    """Prediction of the fitted model: force (N), depth (mm) and mean speed at each level, (n,) each."""

    force: Array
    depth: Array
    mean_m_per_s: Array


def wave_speed(
    readings: SpeedReadings | None,
    *,
    against_force: Line | None = None,
    against_depth: Line | None = None,
    predicted: PredictedSpeeds | None = None,
) -> Figure:
    """Left: speed over force, as in the papers; right: speed over depth, the better test of a model."""
    with style():
        figure = new_figure(7.4, 4.0)
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, name, line, unit in (
            (left, "force", against_force, "N"), (right, "depth", against_depth, "mm"),
        ):  # fmt: skip
            tops = []
            if readings is not None:
                tops.append(_measured(axes, readings, getattr(readings, name), line, unit))
            if predicted is not None:
                tops.append(_predicted(axes, predicted, getattr(predicted, name)))
            axes.set_ylim(bottom=0.0, top=1.1 * max(tops))
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), fontsize=8.5)
        left.set(xlabel="probe force [N]", ylabel="shear-wave speed [m/s]", title="against force")
        right.set(xlabel="indentation depth [mm]", title="against depth")
    return figure


def _measured(axes: Axes, readings: SpeedReadings, x: Array, line: Line | None, unit: str) -> float:
    """Draw the readings; returns the top of the highest error bar."""
    there = np.isfinite(x) & np.isfinite(readings.mean_m_per_s)
    spread = np.where(np.isfinite(readings.sd_m_per_s), readings.sd_m_per_s, 0.0)
    with_bars = bool(np.any(spread[there] > 0))
    axes.errorbar(
        x[there],
        readings.mean_m_per_s[there],
        yerr=spread[there] if with_bars else None,
        fmt="o",
        ms=5,
        capsize=3,
        color=INK,
        ecolor=QUIET,
        label="measured: mean ± SD over pixels" if with_bars else "measured: mean",
    )
    if line is not None:
        ends = np.array([x[there].min(), x[there].max()])
        axes.plot(
            ends,
            line.intercept + line.slope * ends,
            color=BLUE,
            label=line_text(line, unit).replace(",  ", "\n"),
        )
    return float(np.max((readings.mean_m_per_s + spread)[there]))


def _predicted(axes: Axes, predicted: PredictedSpeeds, x: Array) -> float:
    order = np.argsort(x)
    axes.plot(
        x[order], predicted.mean_m_per_s[order], "s-", ms=3.5, color=VERMILION, label="predicted by the fit"
    )
    return float(np.nanmax(predicted.mean_m_per_s))


def line_text(line: Line, unit: str) -> str:
    """
    >>> line_text(Line(0.051, 2.21, 0.934, None, 12), "N")
    '2.21 m/s + 0.051 m/s per N,  R² = 0.934'
    """
    sign = "+" if line.slope >= 0 else "−"
    r2 = "R² undefined (no variation)" if line.r2 is None else f"R² = {line.r2:.3f}"
    return f"{line.intercept:.2f} m/s {sign} {abs(line.slope):.3f} m/s per {unit},  {r2}"
