"""Shear-wave maps in the probe's frame: measured, predicted and their difference, level by level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from limbcli.measurement.elastography import SweMap
from limbcli.model import Array
from limbcli.reporting.figures.style import QUIET, bare, facets, new_figure, style

SPEED_MAP, DIFFERENCE_MAP = "viridis", "RdBu_r"
MOST_LEVELS = 5
_LEAST_INCHES = 1.0


@dataclass(frozen=True, eq=False)
class LevelMaps:
    """One level: its force (N), the predicted map, and the measured one if there is one."""

    level: int
    force: float
    predicted: SweMap
    measured: SweMap | None = None


def chosen_levels(levels: Sequence[LevelMaps]) -> list[LevelMaps]:
    """A few levels, evenly spaced, including first and last; those with measured maps if there are any."""
    best = [each for each in levels if each.measured is not None] or list(levels)
    index = np.unique(np.linspace(0, len(best) - 1, min(len(best), MOST_LEVELS)).round().astype(int))
    return [best[k] for k in index]


def speed_maps(levels: Sequence[LevelMaps], *, toward: str | None = None) -> Figure:
    """One column per level; rows: measured, predicted, and predicted minus measured, or the predicted row
    alone.

    toward : side of the patient towards which `lateral` increases, if known
    """
    shown = chosen_levels(levels)
    paired = any(each.measured is not None for each in shown)
    rows = ("measured", "predicted", "difference") if paired else ("predicted",)
    scale = Normalize(*np.quantile(np.concatenate([p.speed_m_per_s for p in _all(shown)]), [0.01, 0.99]))
    gaps = [np.zeros(1), *(gap.speed_m_per_s for each in shown if (gap := _difference(each)) is not None)]
    reach = max(float(np.quantile(np.abs(np.concatenate(gaps)), 0.98)), 0.05)
    with style():
        figure = new_figure(7.6, 0.9 + len(rows) * (0.3 + _height(shown)))
        panels = figure.subplots(len(rows), len(shown), sharex=True, sharey=True, squeeze=False)
        for column, each in zip(panels.T, shown, strict=True):
            force = f"{max(each.force, 0.0):.1f} N"
            column[0].set_title(force)
            for axes, row in zip(column, rows, strict=True):
                axes.set_label(f"{row}, level {each.level} ({force})")
                content = {
                    "measured": each.measured, "predicted": each.predicted, "difference": _difference(each),
                }[row]  # fmt: skip
                norm = Normalize(-reach, reach) if row == "difference" else scale
                nothing = "no map" if each.measured is None else "no pixel\nof both"
                _panel(axes, content, norm, DIFFERENCE_MAP if row == "difference" else SPEED_MAP, nothing)
        for axes_row, row in zip(panels, rows, strict=True):
            words = "predicted − measured" if row == "difference" else row
            axes_row[0].set_ylabel(f"{words}\ndepth [mm]")
            drawn = next((each.collections[0] for each in axes_row if each.collections), None)
            if drawn is None:
                continue
            label = "difference [m/s]" if row == "difference" else "speed [m/s]"
            figure.colorbar(drawn, ax=list(axes_row), label=label, shrink=0.9)
        panels[0, 0].invert_yaxis()
        side = f" (+ is {toward})" if toward else ""
        across = f"lateral [mm], 0 under the probe's centre{side}; depth 0 at its face"
        figure.supxlabel(across, fontsize=9.5)
    return figure


def _height(shown: Sequence[LevelMaps]) -> float:
    """Height of one panel (inches) by the maps' aspect ratio, with room for the labels beside a flat one."""
    wide = max(float(np.ptp(each.lateral)) for each in _all(shown))
    deep = max(float(np.ptp(each.depth)) for each in _all(shown))
    return float(np.clip(5.4 / len(shown) * deep / max(wide, 1.0), _LEAST_INCHES, 2.4))


def _all(levels: Sequence[LevelMaps]) -> list[SweMap]:
    return [each.predicted for each in levels] + [each.measured for each in levels if each.measured]


def _difference(level: LevelMaps) -> SweMap | None:
    """Predicted minus measured speed at the pixels common to both."""
    if level.measured is None:
        return None
    own, other = level.predicted, level.measured
    known = dict(zip(_places(other), other.speed_m_per_s, strict=True))
    measured = np.array([known.get(place, np.nan) for place in _places(own)])
    both = np.isfinite(measured)
    if not both.any():
        return None
    return SweMap(own.lateral[both], own.depth[both], own.speed_m_per_s[both] - measured[both])


def _places(pixels: SweMap) -> list[tuple[float, float]]:
    at = np.round(np.stack([pixels.lateral, pixels.depth], axis=1), 4)
    return [(float(x), float(z)) for x, z in at]


def _panel(axes: Axes, pixels: SweMap | None, norm: Normalize, colours: str, nothing: str) -> None:
    bare(axes)
    if pixels is None:
        axes.text(0.5, 0.5, nothing, ha="center", va="center", color=QUIET, transform=axes.transAxes)
        return
    half = 0.5 * _size(pixels)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    squares = np.column_stack([pixels.lateral, pixels.depth])[:, None, :] + corners
    facets(axes, squares, array=pixels.speed_m_per_s, norm=norm, cmap=colours, linewidths=0.1)


def _size(pixels: SweMap) -> Array:
    """Width and height (2,) of a pixel (mm), from the spacing of its neighbours; square for a single row or
    column."""
    steps = [np.diff(np.unique(np.round(each, 4))) for each in (pixels.lateral, pixels.depth)]
    known = [float(np.median(each)) for each in steps if len(each)]
    other = known[0] if known else 1.0
    return np.array([float(np.median(each)) if len(each) else other for each in steps])
