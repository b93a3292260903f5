"""The diagnosis as JSON data, and its figures."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from limbcli.diagnostics import thresholds
from limbcli.diagnostics.conclusions.next_measurement import best_step, useful_steps
from limbcli.diagnostics.conclusions.verdict import Diagnosis, Shrink
from limbcli.diagnostics.model.common_errors import CommonError
from limbcli.diagnostics.model.forward_model import Direction
from limbcli.diagnostics.statistical_tests.localisation_tests import PREFIX
from limbcli.drawing import save_figure
from limbcli.effects.base import Parameter
from limbcli.stages.diagnosis.data.joint import slices
from limbcli.stages.diagnosis.data.noise import COMPRESSIBILITY
from limbcli.stages.diagnosis.data.site_data import SiteData
from limbcli.stages.diagnosis.forward_model.fit_parameters import Slot
from limbcli.stages.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.stages.diagnosis.mesh_error.numerical_checks import f_kappa_at
from limbcli.stages.diagnosis.sizes import reported_sizes, value_ends


def diagnosis_json(found: Diagnosis, site: SiteData, forward_model: SiteForwardModel) -> dict[str, Any]:
    """All results of the diagnosis for diagnosis.json; units are in the keys."""
    known = {
        slot.name: slot.parameter for name in forward_model.effects for slot in forward_model.slots((name,))
    }
    family = found.family
    where = [
        {"part": t.name.removeprefix(PREFIX), "p": t.p, "p_adjusted": t.p_adjusted,
         "z_rms_predicted_from_the_rest": _z_rms(found, t.name)}
        for t in family.tests if t.name.startswith(PREFIX)
    ]  # fmt: skip
    candidates = [
        {"name": t.name, "sentence": found.facts[t.name].sentence, "kind": found.facts[t.name].kind,
         "score": t.score.statistic, "p": t.p, "p_adjusted": t.p_adjusted,
         "p_among_effects": t.p_among, "estimate": _estimate(t.score.direction, t.score.eta, known),
         "at": t.score.direction.point}
        for t in family.tests if t.name in found.facts
    ]  # fmt: skip
    useful = useful_steps(found.next_steps)
    best = best_step(found.next_steps) if useful else None
    return {
        "site": site.name,
        "verdict": found.verdict,
        "reason": found.reason,
        "noise": {
            "is_relative": found.relative,
            "parts": site.data.noise.provenance(),
            "estimated_fractions": dict(forward_model.shares),
            "scatter_over_stated": found.roughness.ratio if found.roughness else None,
        },
        "channels": list(site.channels),
        "channels_missing": list(site.missing),
        "overall": vars(family.overall) if family.overall else None,
        "where": where,
        "candidates": sorted(candidates, key=lambda c: (c["p_adjusted"], -c["score"])),
        "common_errors": [vars(each) for each in found.common_errors.get(found.chosen, ())],
        "f_kappa": f_kappa_estimate(found.common_errors.get(found.chosen, ())),
        "refits": [
            {**_refit(each), "f_kappa": f_kappa_estimate(found.common_errors.get(each.explanation, ()))}
            for each in found.refits
        ],
        "confidence_set": [list(each) for each in found.confidence_set],
        "look_alike_cosines": dict(found.angles),
        "added": list(found.chosen),
        "gap_closed": found.closed,
        "shrink": [_stage(stage) for stage in found.shrink],
        "blind_spots": [
            {**vars(spot), "undetectable_at_typical_size": spot.is_undetectable, "matters": spot.matters}
            for spot in found.blind_spots
        ],
        "next_measurement": {
            "recommended": best[0] if best else None,
            "power_for_its_worst_pair": best[1] if best else None,
            "power_for_its_best_pair": useful[0].power if best else None,
            "menu": [vars(step) for step in found.next_steps],
        },
        "sizes_95": reported_sizes(
            sizes_of(forward_model, site), found.sizes, found.estimates.values["c_kpa"], found.refitted_sizes
        ),
        "sizes_refitted": sorted(found.refitted_sizes),
        "not_evaluated": dict(found.not_evaluated),
        "left_out": dict(found.left_out),
        "seed": found.seed,
    }


def f_kappa_estimate(errors: Sequence[CommonError]) -> dict[str, Any] | None:
    """f_kappa of a fit with its 95 % interval, which other errors of the model widen, and that of the prior;
    an end that is open is None. None if its influence was not computed."""
    found = next((each for each in errors if each.name == COMPRESSIBILITY), None)
    if found is None:
        return None
    ends = (-thresholds.SIZE_WITHIN, thresholds.SIZE_WITHIN)
    deviation = min(float(np.hypot(found.deviation, thresholds.F_KAPPA_ERROR)), 1.0)
    return {
        "value": _finite(f_kappa_at(found.value)),
        "interval_95": [_finite(f_kappa_at(found.value + side * deviation)) for side in ends],
        "prior_95": [_finite(f_kappa_at(side)) for side in ends],
    }


def _finite(value: float) -> float | None:
    """The value; None where it is infinite, for an interval that is open there."""
    return value if np.isfinite(value) else None


def _stage(stage: Shrink) -> dict[str, Any]:
    estimates = stage.estimates
    return {
        "explanation": list(stage.explanation), "chi2": stage.chi2, "nu": stage.nu,
        "chi2_per_nu": stage.chi2_per_nu, "rms": dict(stage.rms), "held_out": dict(stage.held_out),
        "placebo_percentile": stage.placebo_percentile, "values": dict(estimates.values),
        "intervals_95": {name: list(ends) for name, ends in estimates.intervals.items()},
        "c_and_m_over": estimates.over, "not_told_by_the_data": list(estimates.open),
        "values_without_prior": dict(estimates.best), "prior": estimates.prior,
    }  # fmt: skip


def _estimate(direction: Direction, eta: np.ndarray, known: Mapping[str, Parameter]) -> dict[str, float]:
    """First-order estimates as parameter values; the upper bound if no finite value has as large an
    effect."""
    found = {}
    for name, x in zip(direction.names, eta, strict=True):
        value = known[name].from_proportional(float(x))
        found[name] = value if np.isfinite(value) else known[name].high
    return found


def _refit(refit: Any) -> dict[str, Any]:
    return {
        "explanation": list(refit.explanation), "chi2": refit.state.chi2, "nu": refit.state.nu,
        "smallest_adjusted_p_left": refit.family.smallest, "deviance_gap": refit.gap,
        "deviance_gap_allowed": refit.gap_allowed, "values": dict(refit.fitted.values),
        "at_bound": list(refit.fitted.at_bound), "in_set": refit.in_set,
    }  # fmt: skip


_GAP_COLUMNS = 3  # panels side by side, so that their text remains legible in print
_GAP_NAME = 20  # largest number of characters of a site's name above a panel
_MOST_SIZES = 10.0  # upper limit of the axis of detectable sizes, in plausible sizes
_MOST_DECADES = 6.0  # largest -log10 of an adjusted p that is drawn
_WIDEST = 4.0  # limits of the axis of size intervals, in plausible sizes
_THINNEST = 0.02  # narrowest visible bar, in plausible sizes
_SHOWN = {"force": "force", "swe": "mean wave speed", "map": "wave-speed map", "travel": "probe travel",
          "layer": "layers", "hold": "force decay in holds"}  # fmt: skip


def gap_picture(found: Diagnosis, sites: Sequence[SiteData], path: Path) -> None:
    """Residuals in standard deviations without and with the effects: one panel per channel and site."""
    channels = [c for c in _SHOWN if any(row.channel == c for site in sites for row in site.rows)]
    columns = min(len(channels), _GAP_COLUMNS)
    rows = -(-len(channels) // columns)
    figure = Figure(figsize=(2.9 * columns, 2.7 * rows * len(sites) + 0.4), layout="constrained")
    axes = figure.subplots(rows * len(sites), columns, squeeze=False)
    for site, inside, lines in zip(sites, slices(sites), np.split(axes, len(sites)), strict=True):
        for ax, channel in zip_longest(lines.flat, channels):
            if channel is None:
                ax.set_axis_off()
                continue
            _gap(ax, found, site, inside, channel)
            name = f"{textwrap.shorten(site.name, _GAP_NAME)}: " if len(sites) > 1 else ""
            ax.set_title(f"{name}{_SHOWN[channel]}", fontsize=9)
        for line in lines:
            line[0].set_ylabel("measured − predicted\n[standard deviations]")
    handles, labels = next(ax for ax in axes.flat if ax.lines[1:]).get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=9, loc="outside lower center", ncols=len(labels))
    save_figure(figure, path, dpi=150)


def _gap(ax: Any, found: Diagnosis, site: SiteData, inside: slice, channel: str) -> None:
    stages = [(found.base, "base model", "#7a7a7a", "o")]
    if found.shrink and len(found.shrink) > 1:
        last = found.shrink[-1].explanation
        final = next(r.fitted for r in found.refits if r.explanation == last)
        stages.append((final, "with " + " + ".join(last), "#0072b2", "s"))
    mask = np.array([row.channel == channel for row in site.rows])
    at = np.arange(int(mask.sum()), dtype=float)
    if channel != "hold":
        at = np.array([site.protocol.depth[row.level] for row in site.rows if row.channel == channel])
    ax.axhspan(-2, 2, color="#eef1f4", zorder=0, label="within two deviations")
    ax.axhline(0, color="#22303c", lw=0.8)
    for fitted, label, color, marker in stages:
        z = (site.data.y - fitted.prediction[inside]) / site.data.deviation
        ax.plot(at, z[mask], marker, ms=4, color=color, label=label, alpha=0.85)
    ax.set_xlabel("force ratios of the holds, in order" if channel == "hold" else "depth [mm]")


def candidates_picture(found: Diagnosis, path: Path) -> None:
    """Adjusted p and detectable size of every candidate."""
    known = [t for t in found.family.tests if t.name in found.facts]
    tests = sorted(known, key=lambda t: (-t.p_adjusted, t.score.statistic))
    figure = Figure(figsize=(8.4, 0.28 * max(len(tests), 4) + 1.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    names = [t.name for t in tests]
    color = ["#d55e00" if t.p_adjusted < 0.05 else "#9aa5b1" for t in tests]
    left.barh(names, [-np.log10(max(t.p_adjusted, 10.0**-_MOST_DECADES)) for t in tests], color=color)
    left.axvline(-np.log10(0.05), color="#22303c", lw=0.8, ls="--")
    left.set_xlabel(f"-log10 of adjusted p\n(dashed: 0.05; {_MOST_DECADES:g}: or more)")
    spots = {spot.name: spot for spot in found.blind_spots}
    sizes = [min(spots[n].detectable_times_typical, _MOST_SIZES) if n in spots else np.nan for n in names]
    right.barh(names, sizes, color="#56b4e9")
    right.axvline(1.0, color="#22303c", lw=0.8, ls="--")
    right.set_xlim(0.0, _MOST_SIZES)
    right.set_xlabel(
        "size detected with 80 % power\n(in plausible sizes; right of dashed:\n"
        f"undetectable; {_MOST_SIZES:g}: or more)"
    )
    save_figure(figure, path, dpi=150)


def sizes_of(forward_model: SiteForwardModel, site: SiteData) -> dict[str, list[Slot]]:
    """Size parameters of every effect; those of this site where each measurement has a separate parameter."""
    here = [each.site.name for each in forward_model.sites].index(site.name)
    return {
        name: [
            slot for slot in forward_model.slots((name,))
            if not slot.parameter.shape and slot.site in (None, here)
        ]
        for name in forward_model.effects
    }  # fmt: skip


def sizes_picture(found: Diagnosis, sizes: Mapping[str, Sequence[Slot]], path: Path) -> None:
    """The interval of every effect's size when it alone is added, in plausible sizes; 0 is no effect.

    A triangle marks an interval that lies entirely outside the axis limits or beyond the largest size
    searched.
    """
    rows = [
        (f"{name}: {slot.name}",
         _in_plausible_sizes(
             slot.parameter, value_ends(slot, found.sizes[name], found.refitted_sizes.get(name))
         ))
        for name, mine in sizes.items() if name in found.sizes
        for slot in mine if slot.name in found.sizes[name]
    ]  # fmt: skip
    figure = Figure(figsize=(8.4, 0.26 * max(len(rows), 4) + 1.2), layout="constrained")
    axes = figure.subplots()
    for k, (_, ends) in enumerate(rows):
        low, high = np.clip(ends, -_WIDEST, _WIDEST)
        color = "#9aa5b1" if low <= 0.0 <= high else "#d55e00"
        axes.barh(k, high - low, left=low, height=0.6, color=color)
        if high - low < _THINNEST:
            axes.plot(low, k, ">" if low > 0 else "<", color=color, clip_on=False)
    axes.set_yticks(range(len(rows)), [name for name, _ in rows], fontsize=8)
    axes.axvline(0.0, color="#22303c", lw=0.8)
    axes.axvline(1.0, color="#22303c", lw=0.8, ls="--")
    axes.set_xlim(-_WIDEST, _WIDEST)
    axes.invert_yaxis()
    axes.set_xlabel(
        "size in plausible sizes, 95 % (dashed: plausible; orange: 0 is outside;\n"
        "triangle: larger than the searched sizes, or than this frame)"
    )
    save_figure(figure, path, dpi=150)


def _in_plausible_sizes(p: Parameter, ends: tuple[float, float]) -> tuple[float, float]:
    """An interval of a parameter's value, clipped to its bounds, in plausible sizes and increasing order."""
    low, high = (float(np.clip(x, p.low, p.high) - p.null) for x in ends)
    first, last = sorted((low / (p.typical - p.null), high / (p.typical - p.null)))
    return first, last


def _z_rms(found: Diagnosis, test: str) -> float | None:
    z = found.held_out_z.get(test.removeprefix(PREFIX))
    return z[0] if z else None
