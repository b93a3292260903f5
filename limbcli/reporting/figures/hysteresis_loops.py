"""The loops of repeated loading, and the energy lost in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from limbcli.model import Array
from limbcli.reporting.figures.style import (
    BLUE,
    GREEN,
    INK,
    MARKERS,
    ORANGE,
    PURPLE,
    QUIET,
    VERMILION,
    new_figure,
    style,
)

_COLOURS = (VERMILION, ORANGE, PURPLE, GREEN, BLUE)
_SHADES = "plasma"  # colour map used if there are more cycles than these colours


@dataclass(frozen=True, eq=False)
class Loop:
    """One cycle: depth (mm) and force (N), (n,), of its loading and its unloading, in the order measured.

    lost, lost_deviation : N mm, None without unloading
    lost_fraction : relative to the work of loading
    """

    number: int
    loading: tuple[Array, Array]
    unloading: tuple[Array, Array]
    lost: float | None = None
    lost_deviation: float | None = None
    lost_fraction: float | None = None


def cycles(loops: Sequence[Loop]) -> Figure:
    """Left: force over depth, one colour per cycle; right: energy lost by cycle, if unloading was read."""
    with style():
        figure = new_figure(7.4, 4.2)
        lossy = [each for each in loops if each.lost is not None]
        if not lossy:
            _draw_loops(figure.subplots(), loops)
            return figure
        left, right = figure.subplots(1, 2, width_ratios=[1.7, 1.0])
        _draw_loops(left, loops)
        right.errorbar(
            [each.number for each in lossy],
            [each.lost or 0.0 for each in lossy],
            yerr=[each.lost_deviation or 0.0 for each in lossy],
            fmt="o-", color=INK, ecolor=QUIET, capsize=3, lw=1.0, label="energy lost",
        )  # fmt: skip
        right.set(xlabel="cycle", ylabel="energy lost [N mm] (±1 SD)")
        right.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        right.set_ylim(bottom=min(0.0, right.get_ylim()[0]))
    return figure


def _draw_loops(axes: Axes, loops: Sequence[Loop]) -> None:
    shown = []
    for k, loop in enumerate(loops):
        colour, mark = _colour(k, len(loops)), MARKERS[k % len(MARKERS)]
        depth, force = loop.loading
        name = f"cycle {loop.number}"
        shown += axes.plot(depth, force, f"{mark}-", ms=4, lw=1.3, color=colour, label=name)
        back, last = loop.unloading, len(loop.loading[0]) - 1
        if not len(back[0]):
            continue
        depth, force = (np.r_[up[last:], down] for up, down in zip(loop.loading, back, strict=True))
        axes.plot(
            depth, force, f"{mark}--", ms=4, lw=1.0, color=colour, mfc="white", zorder=1.5,
            label=f"{name}, unloading",
        )  # fmt: skip
    axes.set(xlabel="indentation depth [mm]", ylabel="probe force [N]")
    title = "dashed: unloading" if any(len(x.unloading[0]) for x in loops) else None
    axes.legend(
        handles=shown, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=4, fontsize=8.5, title=title
    )


def _colour(k: int, n: int) -> str:
    if n <= len(_COLOURS):
        return _COLOURS[k * (len(_COLOURS) - 1) // max(n - 1, 1)]
    return to_hex(colormaps[_SHADES](0.9 * k / (n - 1)))  # its lightest end is hard to see on white
