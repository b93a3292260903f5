"""The figures of a joint fit: depth, speed and layers with the force (one row per site), and the profiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from limbcli.drawing import save_figure
from limbcli.inference.adaptive import Intervals
from limbcli.inference.profile import Profile
from limbcli.inference.site_depth import SiteMeasurement, SitePrediction
from limbcli.measurement.levels import LAYERS
from limbcli.model import Array
from limbcli.numbers.units import kpa_from_mpa
from limbcli.reporting.figures.style import (
    BLUE,
    GREEN,
    INK,
    QUIET,
    VERMILION,
    legend_below,
    log_if_wide,
    new_figure,
    style,
)  # fmt: skip
from limbcli.results import StageWriter

_ROOMY = 3  # largest number of panels wide enough for labels at 1, 2 and 5
_SYMBOLS = {"f_kappa": r"$f_\kappa$"}


def draw_joint(
    sites: Sequence[SiteMeasurement], predicted: Sequence[SitePrediction], found: Intervals,
    writer: StageWriter, *, file: str = "fit-joint.png", of: str = "site",
) -> None:  # fmt: skip
    """Draw fit-joint.png and profiles.png; `of`: what a row of panels represents ("site" or "state")."""
    with style():
        layered = any(len(each.layers) for each in sites)
        figure = new_figure(10.4 if layered else 7.6, 3.0 * len(sites))
        panels = figure.subplots(len(sites), 3 if layered else 2, squeeze=False)
        for data, seen, (left, right, *more) in zip(sites, predicted, panels, strict=True):
            order = np.argsort(data.force)
            left.errorbar(
                data.depth, data.force, xerr=data.depth_deviation, yerr=data.force_deviation,
                fmt="o", ms=4, color=INK, label="measured (±1 SD)",
            )  # fmt: skip
            left.plot(
                np.r_[0, seen.depth[order]], np.r_[0, data.force[order]], color=VERMILION, label="joint fit"
            )
            left.set(xlabel="indentation depth [mm]", ylabel="probe force [N]", title=f"{of} {data.name}")
            left.legend(loc="upper left")
            speed = np.exp(data.log_speed)
            right.errorbar(
                data.speed_force, speed, yerr=speed * data.speed_deviation, fmt="o", ms=4, color=INK,
                label="measured (±1 SD)",
            )  # fmt: skip
            order = np.argsort(data.speed_force)
            right.plot(
                data.speed_force[order], np.exp(seen.log_speed)[order], color=VERMILION, label="joint fit"
            )
            right.set_label(f"{of} {data.name}, speed")
            right.set(xlabel="probe force [N]", ylabel="shear-wave speed [m/s]")
            if not len(speed):
                _nothing(right, "no speeds enter")
            for each in more:
                each.set_label(f"{of} {data.name}, layers")
                _layers(each, data, seen)
        save_figure(figure, writer.file("picture", file))
    draw_profiles(found, found.best, writer)


def _layers(axes: Axes, data: SiteMeasurement, seen: SitePrediction) -> None:
    """Thickness of every layer that enters the likelihood, against force."""
    axes.set(xlabel="probe force [N]", ylabel="thickness [mm]")
    if not len(data.layers):
        _nothing(axes, "no layers enter")
        return
    for j, colour in zip(np.unique(data.layers.layer), (INK, BLUE, GREEN), strict=False):
        here = np.flatnonzero(data.layers.layer == j)
        order = here[np.argsort(data.layers.force[here])]
        spread = np.sqrt(np.diag(data.layers.covariance)[order])
        force, name = data.layers.force[order], LAYERS[j]
        read = data.layers.thickness[order]
        axes.errorbar(force, read, yerr=spread, fmt="o", ms=4, color=colour, label=f"{name} (±1 SD)")
        axes.plot(force, seen.layers[order], color=colour, label=f"{name}, joint fit")
    axes.legend(loc="best")


def _nothing(axes: Axes, words: str) -> None:
    """An empty panel with the reason as text and no ticks."""
    axes.set(xticks=[], yticks=[])
    axes.text(0.5, 0.5, words, ha="center", transform=axes.transAxes)


def draw_profiles(found: Intervals, estimates: Array, writer: StageWriter) -> None:
    """Draw profiles.png. estimates : the fit's values (at least n_profiles,), in the order of the profiles"""
    figure = profile_figure(found.profiles, estimates, found.threshold)
    save_figure(figure, writer.file("profiles", "profiles.png"))


def profile_figure(profiles: Mapping[str, Profile], estimates: Array, limit: float) -> Figure:
    """One panel per parameter: a valley where the data determine it, a plain where not; limit : increase of
    the deviance at the ends of the 95 % intervals"""
    with style():
        figure = new_figure(max(7.4, 1.85 * len(profiles)), 3.3)
        panels = figure.subplots(1, max(len(profiles), 1), sharey=True, squeeze=False)[0]
        for axes, (name, each), estimate in zip(panels, profiles.items(), estimates, strict=False):
            scale, unit = (kpa_from_mpa(1.0), "kPa") if name == "c" else (1.0, "–")
            values = scale * each.values
            axes.plot(values, each.deviance, color=BLUE, zorder=3)
            axes.axvspan(
                scale * each.low, scale * each.high, color=QUIET, alpha=0.2, lw=0, label="95 % interval"
            )
            axes.axhline(limit, color=VERMILION, lw=1.0, ls="--", label="95 % limit")
            axes.axvline(scale * float(estimate), color=INK, lw=1.0, ls=":", label="the fit")
            log_if_wide(axes, "x", values, few=len(profiles) > _ROOMY)
            symbol = _SYMBOLS.get(name, _short(name))
            axes.set(xlabel=f"{symbol} [{unit}]", title=symbol, ylim=(-0.3, 2 * limit))
        panels[0].set_ylabel("increase in deviance, −2 Δ ln L [–]")
        legend_below(figure, panels[0])
    return figure


def _short(name: str) -> str:
    """A parameter's name, shortened to fit in a panel.

    >>> _short("unloaded_stretch_along"), _short("stretch_along_bent"), _short("f_kappa")
    ('unloaded along', 'along bent', 'f_kappa')
    """
    first, stretch, rest = name.partition("stretch_")
    return f"{first}{rest}".replace("_", " ") if stretch else name
