"""Profile likelihoods: how far each parameter can move before the data exclude it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from limbcli.model import Array
from limbcli.numbers.interval_limits import THRESHOLD_95
from limbcli.reporting.figures.style import (
    BLUE,
    INK,
    QUIET,
    VERMILION,
    legend_below,
    log_if_wide,
    new_figure,
    style,
)

_ROOMY = 3  # largest number of panels wide enough for labels at 1, 2 and 5
_SYMBOLS = {"f_kappa": r"$f_\kappa$", "m": "m", "c": "c"}


@dataclass(frozen=True, eq=False)
class ProfileCurve:
    """Profile likelihood of one parameter.

    values : (n,) of the parameter
    deviance : (n,) decrease of twice the log likelihood from its maximum
    estimate : the value of the fit
    limit : deviance at the ends of the 95 % interval
    interval : its ends if they differ from those of the curve (an interval widened to include a fit by
        another method, or an uncertainty that the curve does not include); None: where the curve crosses the
        limit
    """

    name: str
    values: Array
    deviance: Array
    estimate: float
    unit: str = "–"
    limit: float = THRESHOLD_95
    interval: tuple[float, float] | None = None


def profile_figure(profiles: Sequence[ProfileCurve]) -> Figure:
    """One panel per parameter: a valley shows a determined parameter, a plain an undetermined one."""
    with style():
        figure = new_figure(max(7.4, 1.85 * len(profiles)), 3.3)
        panels = figure.subplots(1, max(len(profiles), 1), sharey=True, squeeze=False)[0]
        for axes, profile in zip(panels, profiles, strict=False):
            order = np.argsort(profile.values)
            values, deviance = profile.values[order], profile.deviance[order]
            axes.plot(values, deviance, color=BLUE, zorder=3)
            axes.axvspan(
                *(profile.interval or _not_excluded(values, deviance, profile.limit)),
                color=QUIET,
                alpha=0.2,
                lw=0,
                label="95 % interval",
            )
            axes.axhline(profile.limit, color=VERMILION, lw=1.0, ls="--", label="95 % limit")
            axes.axvline(profile.estimate, color=INK, lw=1.0, ls=":", label="the fit")
            log_if_wide(axes, "x", values, few=len(profiles) > _ROOMY)
            symbol = _SYMBOLS.get(profile.name, profile.name)
            axes.set(xlabel=f"{symbol} [{profile.unit}]", title=symbol, ylim=(-0.3, 2 * profile.limit))
        panels[0].set_ylabel("increase in deviance, −2 Δ ln L [–]")
        legend_below(figure, panels[0])
    return figure


def _not_excluded(values: Array, deviance: Array, limit: float) -> tuple[float, float]:
    """Where the curve crosses the limit on either side of its minimum, or its ends."""
    lowest, ends = int(deviance.argmin()), []
    for side in (slice(lowest, None, -1), slice(lowest, None)):
        outside = np.flatnonzero(deviance[side] > limit)
        if outside.size == 0 or outside[0] == 0:
            ends.append(float(values[side][-1]))
            continue
        pair = slice(outside[0] - 1, outside[0] + 1)
        ends.append(float(np.interp(limit, deviance[side][pair], values[side][pair])))
    return ends[0], ends[1]
