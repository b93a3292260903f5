"""The diagnosis as JSON data, and its figures."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from limbcli.diagnosis.data.noise_parts import COMPRESSIBILITY
from limbcli.diagnosis.data.site_data import SiteData, slices
from limbcli.diagnosis.explanations import decisions
from limbcli.diagnosis.explanations.conclusions import Diagnosis, Shrink
from limbcli.diagnosis.explanations.estimates import PRIOR, TISSUE
from limbcli.diagnosis.explanations.noise import CommonError
from limbcli.diagnosis.explanations.search import Explained
from limbcli.diagnosis.explanations.sentences import recommended
from limbcli.diagnosis.forward_model.predictions import NOTHING, Slot
from limbcli.diagnosis.forward_model.site_forward_model import SiteForwardModel
from limbcli.diagnosis.forward_model.surrogate import SiteCurves
from limbcli.diagnosis.mesh_error.numerical_checks import STIFFER, f_kappa_at
from limbcli.drawing import save_figure
from limbcli.effects.curves import log_force_at
from limbcli.effects.effect import Parameter
from limbcli.feb.settings import USUAL_PENALTY
from limbcli.model import Array
from limbcli.numbers.units import mpa_from_kpa

Interval = tuple[float | None, float | None]
_ON_BOUND = 0.01  # distance from a bound, as a fraction of the range, from which an interval is open there
_WITHIN = 1.96  # half-width of a 95 % interval, in standard deviations
# Root-mean-square error of f_kappa as it is estimated beside c and m, in standard deviations of its prior.
_F_KAPPA_ERROR = 0.7


def diagnosis_json(found: Diagnosis, site: SiteData, forward_model: SiteForwardModel) -> dict[str, Any]:
    """All results of the diagnosis for diagnosis.json; units are in the keys."""
    best = recommended(found)
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
        "probability_of_nothing": found.nothing,
        "adequate_from_probability": found.adequate_from,
        "where": [vars(each) for each in found.check.parts] if found.check else [],
        "left": [vars(each) for each in found.left.parts] if found.left else [],
        "candidates": _candidates(found),
        "explanations": [_explained(each, found) for each in found.explanations[:_MOST_EXPLANATIONS]],
        "confidence_set": [list(each) for each in found.confidence_set],
        "added": list(found.chosen),
        "common_errors": [vars(each) for each in found.common_errors.get(found.chosen, ())],
        "f_kappa": f_kappa_estimate(found.common_errors.get(found.chosen, ())),
        "shrink": [_stage(stage) for stage in found.shrink],
        "blind_spots": [
            {**vars(spot), "undetectable_at_typical_size": spot.is_undetectable, "matters": spot.matters}
            for spot in found.blind_spots
        ],
        "next_measurement": {
            "recommended": best.name if best else None,
            "expected_probability": best.expected_probability if best else None,
            "menu": [vars(step) for step in found.next_steps],
        },
        "sizes_95": reported_sizes(
            sizes_of(forward_model, site), found.sizes, found.estimates.values["c_kpa"]
        ),
        "not_evaluated": dict(found.not_evaluated),
        "seed": found.seed,
    }


def _candidates(found: Diagnosis) -> list[dict[str, Any]]:
    """The effects, the most probable first; evidence and estimate are those of the effect alone."""
    alone = {each.explanation: each for each in found.explanations if len(each.explanation) < 2}
    nothing, rows = alone[()].ln_evidence, []
    for name, probability in sorted(found.effects.items(), key=lambda item: -item[1]):
        one, fitted = alone.get((name,)), found.fits.get((name,))
        rows.append({
            "name": name, "sentence": found.facts[name].sentence, "kind": found.facts[name].kind,
            "probability": probability, "ln_bayes_factor": one.ln_evidence - nothing if one else None,
            "estimate": {size: fitted.values[size] for size in fitted.effect_names} if fitted else {},
            "at": fitted.point if fitted else "",
        })  # fmt: skip
    return rows


def _explained(each: Explained, found: Diagnosis) -> dict[str, Any]:
    fitted = found.fits.get(each.explanation)
    return {
        "explanation": list(each.explanation), "probability": each.probability,
        "ln_evidence": each.ln_evidence,
        "fitted": fitted is not None, "simulated": each.simulated,
        "values": dict(fitted.values) if fitted else {},
        "at_bound": list(fitted.at_bound.values()) if fitted else [],
        "f_kappa": f_kappa_estimate(found.common_errors.get(each.explanation, ())),
    }  # fmt: skip


def f_kappa_estimate(errors: Sequence[CommonError]) -> dict[str, Any] | None:
    """f_kappa of a fit with its 95 % interval, which other errors of the model widen, and that of the prior;
    an end that is open is None. None if its influence was not computed."""
    found = next((each for each in errors if each.name == COMPRESSIBILITY), None)
    if found is None:
        return None
    ends = (-_WITHIN, _WITHIN)
    deviation = min(float(np.hypot(found.deviation, _F_KAPPA_ERROR)), 1.0)
    return {
        "value": _finite(f_kappa_at(found.value)),
        "interval_95": [_finite(f_kappa_at(found.value + side * deviation)) for side in ends],
        "prior_95": [_finite(f_kappa_at(side)) for side in ends],
    }


def _finite(value: float) -> float | None:
    """The value; None where it is infinite, for an interval that is open there."""
    return value if np.isfinite(value) else None


def reported_sizes(
    slots: Mapping[str, Sequence[Slot]], found: Mapping[str, Mapping[str, tuple[float, float]]], c_kpa: float
) -> dict[str, dict[str, Interval]]:
    """Intervals with the names and units in which they are reported, of all size parameters (`slots`) by
    effect; None: open on that side. found : by effect and parameter, the interval of its value; missing
    effects are open"""
    sizes: dict[str, dict[str, Interval]] = {}
    for name, mine in slots.items():
        row: dict[str, Interval] = {}
        for slot in mine:
            p = slot.parameter
            low, high = found.get(name, {}).get(slot.name, (p.low, p.high))
            near = _ON_BOUND * (p.high - p.low)
            open_ends = low <= p.low + near and p.null > p.low, high >= p.high - near and p.null < p.high
            values = [
                None if is_open else _finite(p.quantity(each, c_kpa))
                for each, is_open in zip((low, high), open_ends, strict=True)
            ]
            if p.quantity(1.0, c_kpa) > p.quantity(2.0, c_kpa):
                values.reverse()
            row[p.reported or p.name] = (values[0], values[1])
        sizes[name] = row
    return sizes


def _stage(stage: Shrink) -> dict[str, Any]:
    estimates = stage.estimates
    return {
        "explanation": list(stage.explanation), "chi2": stage.chi2, "nu": stage.nu,
        "chi2_per_nu": stage.chi2_per_nu, "rms": dict(stage.rms), "held_out": dict(stage.held_out),
        "values": dict(estimates.values),
        "intervals_95": {name: list(ends) for name, ends in estimates.intervals.items()},
        "open_ends": {name: list(ends) for name, ends in estimates.open.items()},
        "c_and_m_over": estimates.over, "prior": PRIOR,
        "not_told_by_the_data": [
            f"{letter} {side}" for letter, name in TISSUE.items()
            for side, out in zip(("below", "above"), estimates.open.get(name, ()), strict=False) if out
        ],
    }  # fmt: skip


_MOST_EXPLANATIONS = 40  # in diagnosis.json, the most probable ones
_GAP_COLUMNS = 3  # panels side by side, so that their text remains legible in print
_GAP_NAME = 20  # largest number of characters of a site's name above a panel
_MOST_SIZES = 10.0  # upper limit of the axis of detectable sizes, in plausible sizes
_WIDEST = 4.0  # limits of the axis of size intervals, in plausible sizes
_THINNEST = 0.02  # narrowest visible bar, in plausible sizes
_SHOWN = {"force": "force", "swe": "mean wave speed", "map": "wave-speed map", "travel": "probe travel",
          "layer": "layers", "hold": "force decay in holds"}  # fmt: skip


def gap_picture(found: Diagnosis, sites: Sequence[SiteData], path: Path) -> None:
    """Residuals in standard deviations without and with the effects: one panel per channel and site."""
    channels = [c for c in _SHOWN if any(c in site.rows.channels() for site in sites)]
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
    last = found.shrink[-1].explanation
    if last and last in found.fits:
        stages.append((found.fits[last], "with " + " + ".join(last), "#0072b2", "s"))
    mask = site.rows.among(channel)
    at = np.arange(mask.sum()) if channel == "hold" else site.protocol.depth[site.rows.level[mask]]
    ax.axhspan(-2, 2, color="#eef1f4", zorder=0, label="within two deviations")
    ax.axhline(0, color="#22303c", lw=0.8)
    for fitted, label, color, marker in stages:
        z = (site.data.y - fitted.prediction[inside]) / site.data.deviation
        ax.plot(at, z[mask], marker, ms=4, color=color, label=label, alpha=0.85)
    ax.set_xlabel("force ratios of the holds, in order" if channel == "hold" else "depth [mm]")


def candidates_picture(found: Diagnosis, path: Path) -> None:
    effects = sorted(found.effects.items(), key=lambda item: item[1])
    figure = Figure(figsize=(8.4, 0.28 * max(len(effects), 4) + 1.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    names = [name for name, _ in effects]
    color = ["#d55e00" if p >= decisions.CREDIBLE else "#9aa5b1" for _, p in effects]
    left.barh(names, [p for _, p in effects], color=color)
    left.axvline(decisions.CREDIBLE, color="#22303c", lw=0.8, ls="--")
    left.set_xlim(0.0, 1.0)
    left.set_xlabel(f"probability that it is missing\n(dashed: {decisions.CREDIBLE:g})")
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
    known = forward_model
    here = [each.site.name for each in known.sites].index(site.name)
    return {name: [slot for slot in known.sizes(name) if slot.site in (None, here)] for name in known.effects}


def sizes_picture(found: Diagnosis, sizes: Mapping[str, Sequence[Slot]], path: Path) -> None:
    """The interval of every effect's size when it alone is added, in plausible sizes; 0 is no effect, a
    triangle an interval outside the axis or beyond the largest size searched."""
    rows = [
        (f"{name}: {slot.name}", _in_plausible_sizes(slot.parameter, found.sizes[name][slot.name]))
        for name, mine in sizes.items() for slot in mine if slot.name in found.sizes.get(name, ())
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


_STEP = 0.02  # of ln m, in the derivatives
_MOST_APART = 2.0  # factor between the m found and those of the other forces
_STIFFEST = 1.0  # deviations of f_kappa from the value in the models: the largest that is simulated
# Penalty of a probe that presses as hard as in the diagnosis' curves, which have no penetration: the demo's
# limb (edges of 2.5 mm) gives 0.9 % more force with it than with the usual one, and 0.4 % less than without
# penetration.
_HARD = 4.0 * USUAL_PENALTY


def diagnosed_force(found: Diagnosis, curves: SiteCurves) -> dict[str, Any] | None:
    """`tissue_force` of diagnosis.json, which the limb's stiffness field takes as that of a fit: the forces
    at the loaded levels of c, m and f_kappa alone, their noise, the errors of the model, and forces of other
    m and f_kappa with their derivatives. None without the influence of f_kappa, or a loaded level."""
    site, estimates = curves.site, found.shrink[-1].estimates
    common = {each.name: each for each in found.common_errors.get(found.chosen, ())}
    errors = {each.name: each for each in site.model.errors if each.name in common}
    read, noise = site.seen.protocol, site.seen.noise
    loaded = np.flatnonzero((read.force > 0) & (read.depth > 0) & site.seen.levels.loading[site.seen.keep])
    if COMPRESSIBILITY not in errors or not len(loaded):
        return None
    depths, levels = read.depth[loaded], site.seen.keep[loaded]
    by_f_kappa = errors[COMPRESSIBILITY].log_force[levels]
    c, m, f_kappa = mpa_from_kpa(estimates.values["c_kpa"]), estimates.values["m"], common[COMPRESSIBILITY]

    def logs(ln_m: float, deviations: float = 0.0) -> Array:
        curve = curves.curves(c, float(np.exp(ln_m)), NOTHING, {})
        return log_force_at(curve, depths) + deviations * by_f_kappa

    at = min(f_kappa.value, _STIFFEST)
    around = np.unique([0.0, at, at - f_kappa.deviation])
    other_m = np.clip([*estimates.intervals["m"], m], m / _MOST_APART, m * _MOST_APART)
    places = list(itertools.product(np.unique(other_m).tolist(), around.tolist()))
    # a deviation of f_kappa is one of 1 / f_kappa (`f_kappa_at`)
    slopes = [
        np.column_stack([
            (1.0 / (1.0 - 1.0 / STIFFER) - z) * by_f_kappa,
            (logs(np.log(each) + _STEP) - logs(np.log(each) - _STEP)) / (2 * _STEP),
        ])
        for each, z in places
    ]  # fmt: skip
    rise = curves.curves(c, m, NOTHING, {}).force_curve.read(depths).slopes
    return {
        "depths_mm": depths,
        "fitted_n": np.exp(logs(np.log(m), at)),
        "noise_n": np.hypot(noise.force, rise * noise.depth),
        "model_errors_of_ln": [
            common[name].deviation * each.log_force[levels]
            for name, each in errors.items() if name != COMPRESSIBILITY and each.log_force.any()
        ],
        "c_share": np.ones(len(depths)),
        "contact_penalty": _HARD,
        "simulated": {
            "f_kappa": [f_kappa_at(z) for _, z in places],
            "m": [each for each, _ in places],
            "forces_n": [np.exp(logs(np.log(each), z)) for each, z in places],
            "slopes_of_ln": slopes,
        },
    }  # fmt: skip
