"""Progress of the identification, and convergence of the solver's residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from limbcli.model import Array
from limbcli.reporting.figures.style import (
    BLUE,
    GREEN,
    VERMILION,
    legend_below,
    log_if_wide,
    new_figure,
    plain_log,
    style,
)


@dataclass(frozen=True, eq=False)
class FitWalk:
    """Accepted iterates of one fit: iteration (n,), sum of squares (n,) N^2, parameters name -> (n,)."""

    key: str
    label: str
    cost_n2: Array
    parameters: dict[str, Array]


@dataclass(frozen=True, eq=False)
class Residuals:
    """Solver iterations in order: worst norm over its target (n,), 1 or less if converged; load step (n,)."""

    ratio: Array
    level: Array


_LEAST_N2 = 1e-8  # smaller values (N²) are drawn here: 0.1 mN in all, below any load cell's resolution
_COLOURS = {"mooney-rivlin": BLUE, "ogden": VERMILION}
_SYMBOLS = {"f_kappa": r"$f_\kappa$ [–]", "m": "m [–]", "c_kpa": "c [kPa]", "kappa_kpa": "κ′ [kPa]"}


def fit_walk(walks: Sequence[FitWalk]) -> Figure:
    """One panel for the sum of squared force residuals, and one for each free parameter."""
    names = list(dict.fromkeys(name for walk in walks for name in walk.parameters))
    with style():
        figure = new_figure(7.4, 3.3)
        panels = np.atleast_1d(figure.subplots(1, 1 + len(names)))
        for walk in walks:
            colour = _COLOURS.get(walk.key, GREEN)
            cost = np.maximum(walk.cost_n2, _LEAST_N2)
            panels[0].semilogy(cost, "o-", ms=4, color=colour, label=walk.label)
            for axes, name in zip(panels[1:], names, strict=True):
                if name in walk.parameters:
                    axes.plot(walk.parameters[name], "o-", ms=4, color=colour, label=walk.label)
        panels[0].set(ylabel="sum of squared force differences [N²]", title="misfit")
        for axes, name in zip(panels[1:], names, strict=True):
            axes.set(ylabel=_SYMBOLS.get(name, name), title=_SYMBOLS.get(name, name).split(" [")[0])
            values = np.concatenate([w.parameters[name] for w in walks if name in w.parameters])
            log_if_wide(axes, "y", values)
        plain_log(panels[0].yaxis)
        last = max(1, *(len(walk.cost_n2) - 1 for walk in walks))
        for axes in panels:
            axes.set(xlabel="iteration", xlim=(-0.05 * last, 1.05 * last))
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        legend_below(figure, panels[0])
    return figure


def newton_residuals(residuals: Residuals) -> Figure:
    """Worst norm over target of each solver iteration, load step by load step."""
    with style():
        figure = new_figure(7.4, 2.9)
        axes = figure.subplots()
        ends = np.flatnonzero(np.diff(residuals.level)) + 1
        for numbers in np.split(np.arange(residuals.ratio.size), ends):
            axes.semilogy(
                numbers + 1, np.maximum(residuals.ratio[numbers], 1e-12), ".-", lw=0.9, ms=4, color=BLUE
            )
        axes.axhline(1.0, color=VERMILION, lw=1.2, label="target")
        axes.set(xlabel="solver iteration (one line a load step)", ylabel="residual over its target [–]")
        axes.legend(loc="upper right")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure
