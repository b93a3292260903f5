"""Measured force over depth, the simulated curves, and their residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from limbcli.model import Array
from limbcli.reporting.figures.style import BLUE, INK, QUIET, VERMILION, new_figure, style

LOOKS: dict[str, tuple[str, str]] = {
    "start": (QUIET, ":"),
    "mooney-rivlin": (BLUE, "--"),
    "ogden": (VERMILION, "-"),
}
_OTHER = ("#5b6b78", "-.")


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """Levels of one site: depth (n,) mm, force (n,) N, one standard deviation each, unloading or not (n,).

    counted : depths (k,) mm and the standard deviation of the force (k,) N that the fit counted there
    """

    depth: Array
    force: Array
    depth_sd: float | None = None
    force_sd: float | None = None
    unloading: Array | None = None
    counted: tuple[Array, Array] | None = None


@dataclass(frozen=True, eq=False)
class SimulatedCurve:
    """A simulated curve: depth (n,) mm, force (n,) N.

    key : "start", "mooney-rivlin", "ogden"
    label : for the legend
    at_levels : (n_levels,) N at the measured depths, as interpolated by the fit (NaN elsewhere); None:
        interpolated from the curve
    """

    key: str
    label: str
    depth: Array
    force: Array
    at_levels: Array | None = None


def force_depth(measured: MeasuredCurve, curves: Sequence[SimulatedCurve]) -> Figure:
    """Two panels: force over depth; measured minus simulated force at the measured depths."""
    with style():
        figure = new_figure(7.2, 5.0 if curves else 3.8)
        if not curves:
            axes = figure.subplots()
            _draw_measured(axes, measured)
            axes.set(xlabel="indentation depth [mm]", ylabel="probe force [N]")
            _legend(figure, axes)
            return figure
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.6, 1.0])
        for curve in curves:
            colour, dashes = LOOKS.get(curve.key, _OTHER)
            upper.plot(curve.depth, curve.force, color=colour, linestyle=dashes, label=curve.label)
        _draw_measured(upper, measured)
        _limit(upper, measured, curves)
        upper.set(ylabel="probe force [N]")
        _legend(figure, upper)
        for curve in curves:
            _draw_difference(lower, measured, curve)
        if measured.counted is not None:
            depth, spread = _band(measured)
            lower.fill_between(depth, -spread, spread, color=QUIET, alpha=0.25, lw=0, label="±1 SD counted")
        elif measured.force_sd:
            half = measured.force_sd
            lower.axhspan(-half, half, color=QUIET, alpha=0.25, lw=0, label="±1 SD of the load cell")
        lower.axhline(0.0, color=INK, lw=0.8, label="no difference")
        lower.set(xlabel="indentation depth [mm]", ylabel="measured −\nsimulated [N]")
        # scale the axis to the fits, not to the start curve, which is expected to be far off
        fits = [each for each in curves if each.key != "start"] or list(curves)
        sizes = [np.abs(_difference(measured, each)) for each in fits]
        largest = max((float(np.nanmax(each)) for each in sizes if np.isfinite(each).any()), default=0.0)
        counted = (
            float(_band(measured)[1].max())
            if measured.counted is not None
            else 2.0 * (measured.force_sd or 0.0)
        )
        span = 1.25 * max(largest, counted, 1e-3)
        lower.set_ylim(-span, span)
    return figure


def _legend(figure: Figure, axes: Axes) -> None:
    """The legend above the panels, where it cannot cover a curve."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2, fontsize=8.5)


def _draw_measured(axes: Axes, measured: MeasuredCurve) -> None:
    unloading = _unloading(measured)
    for part, face, label in ((~unloading, INK, "measured"), (unloading, "white", "measured, unloading")):
        if part.any():
            axes.errorbar(
                measured.depth[part], measured.force[part], xerr=measured.depth_sd, yerr=measured.force_sd,
                fmt="o", ms=5, color=INK, mfc=face, elinewidth=0.9, label=label + _noise_words(measured),
                zorder=5,
            )  # fmt: skip


def _unloading(measured: MeasuredCurve) -> NDArray[np.bool_]:
    if measured.unloading is None:
        return np.zeros(measured.depth.size, dtype=bool)
    return np.asarray(measured.unloading, dtype=bool)


def _noise_words(measured: MeasuredCurve) -> str:
    if not measured.depth_sd or not measured.force_sd:
        return ""
    return f" (bars: ±1 SD, {measured.depth_sd:g} mm and {measured.force_sd:g} N)"


def _limit(axes: Axes, measured: MeasuredCurve, curves: Sequence[SimulatedCurve]) -> None:
    """Limit the force axis: with fits, a start curve far above the data must not compress them; alone, it is
    shown completely."""
    bar = measured.force_sd or 0.0
    alone = [] if any(each.key != "start" for each in curves) else [each.force for each in curves]
    shown = np.concatenate([measured.force - bar, measured.force + bar, *alone])
    low, high = min(0.0, float(np.nanmin(shown))), max(0.0, float(np.nanmax(shown)))
    span = max(high - low, 1e-6)
    axes.set_ylim(low - 0.04 * span, high + 0.08 * span)


def _difference(measured: MeasuredCurve, curve: SimulatedCurve) -> Array:
    if curve.at_levels is not None:
        return measured.force - curve.at_levels
    order = np.argsort(curve.depth, kind="stable")
    read = np.interp(measured.depth, curve.depth[order], curve.force[order], left=np.nan, right=np.nan)
    return measured.force - read


def _draw_difference(axes: Axes, measured: MeasuredCurve, curve: SimulatedCurve) -> None:
    difference = _difference(measured, curve)
    colour, dashes = LOOKS.get(curve.key, _OTHER)
    order = np.argsort(measured.depth, kind="stable")
    order = order[np.isfinite(difference[order])]
    back = _unloading(measured)[order]
    up, down = order[~back], order[back]
    axes.plot(
        measured.depth[up], difference[up], "o", linestyle=dashes, ms=3.5, lw=1.0, color=colour,
        label=curve.label,
    )  # fmt: skip
    if len(down):  # unloading levels are not fitted
        axes.plot(
            measured.depth[down], difference[down], "o", ms=3.5, color=colour, mfc="white",
            label=f"{curve.label}, unloading",
        )  # fmt: skip


def _band(measured: MeasuredCurve) -> tuple[Array, Array]:
    """Depths (k,) and the counted standard deviation there (k,), with the first held back to the start."""
    assert measured.counted is not None
    order = np.argsort(measured.counted[0], kind="stable")
    depth, spread = (each[order] for each in measured.counted)
    return np.r_[min(0.0, float(depth[0])), depth], np.r_[spread[0], spread]
