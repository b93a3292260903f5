"""How far each parameter can go before the data object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from limbcli.model import Array
from limbcli.reporting.figures.style import BLUE, INK, QUIET, VERMILION, new_figure, style

# 95 % quantile of chi-square with one degree of freedom.
THRESHOLD_95 = 3.8415
_SYMBOLS = {"f_kappa": "f_κ", "m": "m", "c": "c"}


@dataclass(frozen=True, eq=False)
class ProfileCurve:
    """values (n,) of a parameter; deviance (n,) fall of twice the log likelihood; the fit's value."""

    name: str
    values: Array
    deviance: Array
    estimate: float


def profile_figure(profiles: Sequence[ProfileCurve]) -> Figure:
    """A panel a parameter: a valley is an answer, a plain is none."""
    with style():
        figure = new_figure(7.4, 3.1)
        panels = figure.subplots(1, max(len(profiles), 1), sharey=True, squeeze=False)[0]
        for axes, profile in zip(panels, profiles, strict=False):
            order = np.argsort(profile.values)
            values, deviance = profile.values[order], profile.deviance[order]
            inside = deviance <= THRESHOLD_95
            axes.plot(values, deviance, color=BLUE, zorder=3)
            if inside.any():
                axes.axvspan(values[inside].min(), values[inside].max(), color=QUIET, alpha=0.2, lw=0)
            axes.axhline(THRESHOLD_95, color=VERMILION, lw=1.0, ls="--", label="95 % limit")
            axes.axvline(profile.estimate, color=INK, lw=1.0, ls=":", label="the fit")
            if values.min() > 0 and values.max() > 5 * values.min():
                axes.set_xscale("log")
                axes.xaxis.set_minor_formatter(NullFormatter())
            symbol = _SYMBOLS.get(profile.name, profile.name)
            axes.set(xlabel=f"{symbol} [–]", title=symbol, ylim=(-0.3, 3 * THRESHOLD_95))
        panels[0].set_ylabel("fall of the likelihood (deviance) [–]")
        panels[0].legend(loc="upper center")
    return figure
