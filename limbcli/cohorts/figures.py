"""Drawings of a cohort: tissue of each person, misfit of the model, misfit of a homogeneous tissue, and
predicted compliance."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

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
    literal,
    new_figure,
    plain_log,
    style,
)

Row = Mapping[str, Any]
_PARAMETERS = (("c_muscle_kpa", "c of muscle [kPa]"), ("c_fat_kpa", "c of fat [kPa]"), ("m", "m [–]"))
_COLOURS = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, "#56b4e9", "#8a6d00", QUIET)
_LABELS_UPRIGHT = 5
_NAME_WIDTH = 20  # characters per line of a label
_TICKS = (-50, -20, -10, -5, -2, 0, 2, 5, 10, 20, 50)


def distributions(rows: Sequence[Row], sites: Mapping[str, Any]) -> Figure:
    """One dot per person with the 95 % interval behind it; the bar shows the population's mean and spread."""
    names = list(sites)
    with style():
        figure = new_figure(max(7.4, 1.1 * len(names)), 7.6)
        for axes, (key, label) in zip(figure.subplots(3, 1, sharex=True), _PARAMETERS, strict=True):
            for place, name in enumerate(names):
                own = sorted(
                    (row for row in rows if row["location"] == name), key=lambda row: float(row[key])
                )
                x = place + np.linspace(-0.33, 0.2, len(own))
                values, low, high = (_column(own, f"{key}{end}") for end in ("", "_low", "_high"))
                site_label = literal(name)
                axes.vlines(x, low, high, color=BLUE, alpha=0.18, lw=1.2, label=f"{site_label}, 95 %")
                axes.plot(x, values, ".", color=BLUE, ms=4, alpha=0.8, label=site_label)
                _bar(axes, place + 0.34, sites[name]["population"][key], site_label)
            axes.set(yscale="log", ylabel=label)
            plain_log(axes.yaxis)
            axes.grid(axis="x", visible=False)
        upright = len(names) <= _LABELS_UPRIGHT
        shown = [literal(textwrap.fill(each, _NAME_WIDTH)) for each in names]
        axes.set_xticks(
            range(len(names)), shown, fontsize=9, rotation=0 if upright else 30,
            ha="center" if upright else "right", rotation_mode="anchor",
        )  # fmt: skip
        marks = [
            Line2D([], [], color=BLUE, marker=".", lw=1.2, label="a person, 95 %"),
            Line2D(
                [], [], color=VERMILION, marker="_", ms=14, mew=2, lw=0, label="geometric mean of the people"
            ),
            Line2D([], [], color=VERMILION, lw=2, label="its 95 % interval"),
            Line2D([], [], color=VERMILION, lw=5, alpha=0.45, label="spread between people (×/÷ 1 SD)"),
        ]
        figure.legend(handles=marks, loc="outside upper center", ncols=4, fontsize=8.5)
    return figure


def _bar(axes: Axes, x: float, own: Mapping[str, Any], name: str) -> None:
    if own["beyond_family"]:
        return  # known on one side only
    middle, factor = own["geometric_mean"], own["spread_factor"]
    axes.plot(
        [x, x], [middle / factor, middle * factor], color=VERMILION, lw=5, alpha=0.45, solid_capstyle="butt",
        label=f"{name}, spread between people",
    )  # fmt: skip
    axes.plot(
        [x, x], [own["low"], own["high"]], color=VERMILION, lw=2, label=f"{name}, 95 % interval of the mean"
    )
    axes.plot(x, middle, "_", color=VERMILION, ms=14, mew=2, label=f"{name}, geometric mean of the people")


def misfits(rows: Sequence[Row]) -> Figure:
    """Left: fat's fraction of the shortening below the skin; right: skin's fraction of the total, not used in
    the fit."""
    with style():
        figure = new_figure(7.4, 3.8)
        left, right = figure.subplots(1, 2)
        for axes, key, title in (
            (left, "fat_part", "fat’s share of fat and muscle"),
            (right, "skin_part", "skin’s share of the whole (not used)"),
        ):
            measured, answered = _column(rows, key), _column(rows, f"{key}_predicted")
            ends = float(min(measured.min(), answered.min())), float(max(measured.max(), answered.max()))
            axes.plot(ends, ends, color=QUIET, lw=1)
            axes.plot(measured, answered, ".", color=BLUE, ms=4, alpha=0.6)
            axes.set(xlabel="measured [–]", ylabel="of the model [–]", title=title)
    return figure


def one_tissue(rows: Sequence[Row]) -> Figure:
    """Error of a homogeneous tissue in the shortening of the fat, over the fat thickness."""
    with style():
        figure = new_figure(7.0, 3.8)
        axes = figure.subplots()
        fat, missed = _column(rows, "fat_mm"), _column(rows, "one_tissue_misses_noise_deviations")
        axes.axhspan(-2, 2, color=GREEN, alpha=0.12, lw=0, label="within two deviations of the edges’ noise")
        axes.axhline(0, color=QUIET, lw=1)
        axes.plot(fat, missed, ".", color=BLUE, ms=4, alpha=0.6)
        axes.set(
            xscale="log",
            xlabel="fat at first contact [mm]",
            ylabel="fat shortens more than one tissue would\n[noise deviations]",
        )
        plain_log(axes.xaxis)
        axes.set_yscale("symlog", linthresh=5)
        least, most = axes.get_ylim()
        ticks = [each for each in _TICKS if least <= each <= most]
        axes.set_yticks(ticks, [f"{each:g}" for each in ticks])
        axes.set_yticks([], minor=True)
        axes.legend(loc="upper left")
    return figure


def compliance(entries: Sequence[Row]) -> Figure:
    """Compliance of held-out people: predicted over measured, by site."""
    with style():
        figure = new_figure(7.4, 5.2)
        axes = figure.subplots()
        sites = sorted({str(each["location"]) for each in entries})
        every = np.concatenate(
            [_column(entries, f"{which}_mm_per_mpa") for which in ("measured", "predicted")]
        )
        ends = np.array([0.85 * every.min(), 1.15 * every.max()])
        axes.plot(ends, ends, color=INK, lw=1)
        axes.fill_between(ends, 0.75 * ends, 1.25 * ends, color=QUIET, alpha=0.15, lw=0, label="within 25 %")
        for k, site in enumerate(sites):
            own = [each for each in entries if each["location"] == site]
            axes.plot(
                _column(own, "measured_mm_per_mpa"),
                _column(own, "predicted_mm_per_mpa"),
                MARKERS[(k + k // len(_COLOURS)) % len(MARKERS)],  # no two sites share colour and mark
                ms=4,
                ls="none",
                alpha=0.7,
                color=_COLOURS[k % len(_COLOURS)],
                label=literal(textwrap.fill(site, _NAME_WIDTH)),
            )
        axes.set(
            xscale="log",
            yscale="log",
            xlim=ends,
            ylim=ends,
            xlabel="measured compliance [mm/MPa]",
            ylabel="predicted, person held out [mm/MPa]",
        )
        axes.set_aspect("equal")
        for axis in (axes.xaxis, axes.yaxis):
            plain_log(axis)
        axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _column(rows: Sequence[Row], key: str) -> Array:
    return np.array([np.nan if row[key] is None else float(row[key]) for row in rows])
