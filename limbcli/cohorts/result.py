"""The results of a cohort: for every site, for every row, and the outliers."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtr

from limbcli.cohorts.estimate import SiteEstimate
from limbcli.cohorts.population import C_FAT, C_MUSCLE, PARAMETERS, M
from limbcli.cohorts.table import LAYERS, CohortTable
from limbcli.inference.layered_family import EXPONENT, HIGH, LOW, RATIO
from limbcli.model import Array
from limbcli.numbers.units import kpa_from_mpa

_LEVEL = 0.05
_KEYS = ("c_muscle_kpa", "c_fat_kpa", "m")
# By how much c_fat/c_muscle falls, and c_muscle rises, at equal readings if muscle slides on the bone, skin
# and fascia are stiff and the flanks near: what a table does not hold (docs/cohort.md, "What c_fat is not").
UNTOLD_RATIO, UNTOLD_MUSCLE = (6.0, 13.0), (1.5, 3.0)
_FAT_BANDS_MM = (0.0, 2.0, 4.0, 8.0, 15.0, np.inf)


def natural(theta: Array) -> Array:
    """c_muscle (kPa), c_fat (kPa) and m from their logarithms (..., 3), where c is in MPa."""
    values = np.exp(theta)
    values[..., [C_MUSCLE, C_FAT]] = kpa_from_mpa(values[..., [C_MUSCLE, C_FAT]])
    return np.asarray(values)


def within_family(theta: Array, middle: Array) -> Array:
    """theta (n, 3) with c_fat and m clipped to the range of the family at c_muscle of the rows (`middle`).

    Outside the range the model's readings are those of its end, so only the side is known there.
    """
    out = theta.copy()
    apart = theta[:, C_FAT] - middle[:, C_MUSCLE]
    out[:, C_FAT] = middle[:, C_MUSCLE] + np.clip(apart, LOW[RATIO], HIGH[RATIO])
    out[:, M] = np.clip(theta[:, M], LOW[EXPONENT], HIGH[EXPONENT])
    return out


def site_entry(table: CohortTable, site: SiteEstimate) -> dict[str, Any]:
    """Population of a site: geometric means with 95 % intervals, spread as a factor, and row statistics."""
    people = site.population
    middle = natural(people.mean)
    low, high = map(natural, people.mean_interval)
    beyond = {"m": m_beyond(people.mean), "c_fat_kpa": c_fat_beyond(people.mean)}
    spread, (spread_low, spread_high) = people.deviation, people.deviation_interval
    root = np.sqrt(np.diag(people.spread))
    together = people.spread / np.outer(root, root)
    parameters = {
        key: {
            "geometric_mean": middle[k],
            "low": low[k],
            "high": high[k],
            "spread_factor": float(np.exp(spread[k])),
            "spread_of_ln": spread[k],
            "spread_of_ln_low": spread_low[k],
            "spread_of_ln_high": spread_high[k],
            "mean_shrinkage": float(site.found.shrinkage[:, k].mean()),
            "beyond_family": beyond.get(key),
        }
        for k, key in enumerate(_KEYS)
    }
    ratio = people.mean[C_FAT] - people.mean[C_MUSCLE]
    return {
        "n_rows": len(site.rows),
        "n_people": len(set(table.person[site.rows].tolist())),
        "population": parameters,
        "c_fat_over_c_muscle": float(np.exp(ratio)),
        "correlation": {
            f"{a} {b}": float(together[i, j])
            for i, a in enumerate(PARAMETERS)
            for j, b in enumerate(PARAMETERS)
            if i < j
        },
        "rounds": people.rounds,
        "effective_draws_least": float(site.found.effective.min()),
        "effective_draws_median": float(np.median(site.found.effective)),
        "homogeneous": homogeneous(table, site),
    }


def family_ends() -> str:
    """The range of the family's tissue parameters in words."""
    low, high = np.exp([LOW, HIGH])
    named = (("c_fat/c_muscle", RATIO), ("m", EXPONENT))
    return ", ".join(f"{name} {low[k]:.3g} to {high[k]:.3g}" for name, k in named)


def m_beyond(mean: Array) -> str | None:
    """In words, if the population's m is outside the family's range: then only the side is known."""
    return _beyond(mean[M], EXPONENT)


def _beyond(ln_mean: float, k: int) -> str | None:
    low, mean, high = np.exp([LOW[k], ln_mean, HIGH[k]])
    return f"below {low:.3g}" if mean < low else f"above {high:.3g}" if mean > high else None


def c_fat_beyond(mean: Array) -> str | None:
    """The same for c_fat / c_muscle."""
    beyond = _beyond(mean[C_FAT] - mean[C_MUSCLE], RATIO)
    return beyond and f"{beyond} c_muscle"


def fat_words(table: CohortTable, sites: Sequence[SiteEstimate]) -> str:
    """Why c_fat is not fat's stiffness: the first sentence of a cohort's results, without its full stop."""
    stiffer = [each.name for each in sites if each.population.mean[C_FAT] > each.population.mean[C_MUSCLE]]
    strain = table.shortened / table.thickness
    fat, muscle = (100 * float(np.median(strain[:, LAYERS.index(name)])) for name in ("fat", "muscle"))
    found = (
        f"c_fat exceeds c_muscle at {len(stiffer)} of {len(sites)} sites (fat shortens by {fat:.0f} %, "
        f"muscle by {muscle:.0f} %, medians), but "
        if stiffer
        else ""
    )
    lower, higher = (f"{low:g} to {high:g} times" for low, high in (UNTOLD_RATIO, UNTOLD_MUSCLE))
    return (
        f"Fat's stiffness cannot be had from these data: {found}where muscle slides on the bone, skin and "
        "fascia are stiff and the limb is narrow, which the table does not tell, the same readings mean a "
        f"c_fat/c_muscle {lower} lower and a c_muscle {higher} higher. c_fat is a number of the bonded slab; "
        "compare c_muscle between people at one site"
    )


def missed_by_one_tissue(site: SiteEstimate) -> Array:
    """Excess shortening of fat (n,) over that of a homogeneous tissue, in standard deviations of the noise.

    The homogeneous tissue has c_muscle and m of the row.
    """
    theta = site.found.mean.copy()
    theta[:, C_FAT] = theta[:, C_MUSCLE]
    expected, _ = site.model(theta, False)
    return np.asarray((site.readings[:, 2] - expected[:, 2]) / np.sqrt(site.noise[:, 2, 2]))


def homogeneous(table: CohortTable, site: SiteEstimate) -> dict[str, Any]:
    """Misfit of a homogeneous tissue to the layers' shortening, in standard deviations of the edge noise."""
    missed = missed_by_one_tissue(site)
    fat = table.thickness[site.rows, 1]
    bands = {}
    for low, high in itertools.pairwise(_FAT_BANDS_MM):
        here = (fat >= low) & (fat < high)
        if here.any():
            name = f"{low:g} to {high:g} mm" if np.isfinite(high) else f"{low:g} mm and more"
            bands[name] = {
                "n_rows": int(here.sum()),
                "median_noise_deviations": float(np.median(missed[here])),
                "share_beyond_2": float(np.mean(np.abs(missed[here]) > 2)),
            }
    return {
        "median_noise_deviations": float(np.median(missed)),
        "median_absolute_noise_deviations": float(np.median(np.abs(missed))),
        "share_beyond_2": float(np.mean(np.abs(missed) > 2)),
        "by_fat_thickness": bands,
    }


def row_entries(
    table: CohortTable, sites: list[SiteEstimate], predicted: dict[str, Any]
) -> list[dict[str, Any]]:
    """Every row, in the table's order: tissue with intervals, misfits, compliance predicted when left out."""
    entries: dict[int, dict[str, Any]] = {}
    left_out = predicted["rows"]
    for site in sites:
        found = site.found
        middle = within_family(found.mean, found.mean)
        values, low, high = (
            natural(within_family(each, middle)) for each in (found.mean, found.low, found.high)
        )
        answered, _ = site.model(found.mean, False)
        skin = site.model.skin_part(found.mean)
        p = chdtrc(site.readings.shape[1], found.misfit)
        at_end, inside = site.model.at_an_end(found.mode), site.model.inside
        one = missed_by_one_tissue(site)
        for i, row in enumerate(site.rows):
            k = int(row)
            entry: dict[str, Any] = {
                "subject": str(table.person[k]),
                "location": str(table.site[k]),
                "line": int(table.lines[k]),
                **{f"{name}_mm": float(table.thickness[k, j]) for j, name in enumerate(LAYERS)},
            }
            for j, key in enumerate(_KEYS):
                entry |= {
                    key: values[i, j],
                    f"{key}_low": low[i, j],
                    f"{key}_high": high[i, j],
                    f"{key}_shrinkage": found.shrinkage[i, j],
                }
            entry |= {
                "force_missed_percent": 100 * float(np.expm1(answered[i, 0] - site.readings[i, 0])),
                "fat_part": site.readings[i, 2],
                "fat_part_predicted": answered[i, 2],
                "skin_part": float(table.shortened[k, 0] / table.depth[k]),
                "skin_part_predicted": skin[i],
                "one_tissue_misses_noise_deviations": one[i],
                "stands_out_p": p[i],
                "effective_draws": found.effective[i],
                "outside_family": bool(not inside[i]),
                "tissue_at_an_end": bool(at_end[i]),
            }
            reported = left_out[k] if left_out else {}
            entry |= {
                "fold": reported.get("fold"),
                "compliance_mm_per_mpa": float(table.compliance[k]),
                "compliance_left_out_mm_per_mpa": reported.get("predicted_mm_per_mpa"),
            }
            entries[k] = entry
    return [entries[k] for k in sorted(entries)]


def outliers(table: CohortTable, sites: list[SiteEstimate]) -> dict[str, Any]:
    """Rows and people that are outliers of their population, after Holm's adjustment for their number."""
    rows, p_rows = [], []
    for site in sites:
        for i, row in enumerate(site.rows):
            rows.append((str(table.person[row]), site.name, int(table.lines[row])))
            p_rows.append(float(chdtrc(site.readings.shape[1], site.found.misfit[i])))
    adjusted = holm(np.array(p_rows))
    listed = [
        {
            "subject": rows[k][0],
            "location": rows[k][1],
            "line": rows[k][2],
            "p": p_rows[k],
            "p_adjusted": float(adjusted[k]),
        }
        for k in np.argsort(adjusted, kind="stable")
        if adjusted[k] < _LEVEL
    ]
    return {"level": _LEVEL, "rows": listed, "people": people_apart(table, sites)}


def people_apart(table: CohortTable, sites: list[SiteEstimate]) -> list[dict[str, Any]]:
    """People whose muscle is significantly stiffer or softer than others' over all of their sites."""
    scores: dict[str, list[float]] = {}
    for site in sites:
        persons = table.person[site.rows].astype(str)
        apart = site.found.mean[:, C_MUSCLE] - site.population.mean[C_MUSCLE]
        own = {each: float(apart[persons == each].mean()) for each in sorted(set(persons.tolist()))}
        scale = max(float(np.std(list(own.values()))), 1e-9)
        for name, value in own.items():
            scores.setdefault(name, []).append(value / scale)
    names = sorted(scores)
    z = person_scores([scores[each] for each in names])
    adjusted = holm(2 * ndtr(-np.abs(z)))
    return [
        {
            "subject": names[k],
            "n_rows": int(np.sum(table.person.astype(str) == names[k])),
            "muscle": "stiffer" if z[k] > 0 else "softer",
            "z": float(z[k]),
            "p_adjusted": float(adjusted[k]),
        }
        for k in np.argsort(adjusted, kind="stable")
        if adjusted[k] < _LEVEL
    ]


def person_scores(scores: Sequence[Sequence[float]]) -> Array:
    """z (n,) of each person's mean score over sites; scores have variance 1 at every site.

    The variance of a mean over several sites follows from the correlation between sites estimated from all
    people, not only from the few who were measured at equally many sites.
    """
    counts = np.array([len(each) for each in scores])
    total = np.array([np.sum(each) for each in scores])
    squares = np.array([np.sum(np.square(each)) for each in scores])
    pairs = int(np.sum(counts * (counts - 1)))
    alike = float(np.clip(np.sum(total**2 - squares) / pairs, 0.0, 1.0)) if pairs else 0.0
    return np.asarray(total / counts / np.sqrt(alike + (1.0 - alike) / counts))


def holm(p: Array) -> Array:
    """p-values (n,) adjusted for their number, by Holm's method.

    >>> holm(np.array([0.01, 0.04, 0.5])).round(2).tolist()
    [0.03, 0.08, 0.5]
    """
    order = np.argsort(p, kind="stable")
    stepped = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    out = np.empty_like(p)
    out[order] = np.minimum(stepped, 1.0)
    return out


def summary_lines(data: dict[str, Any], page: Path) -> list[str]:
    """The summary printed on the terminal."""
    lines = [f"{data['fat_stiffness']['words']}.", f"{data['n_rows']} rows of {data['n_people']} people"]
    for name, site in data["sites"].items():
        reported = []
        for key, unit in zip(_KEYS, (" kPa", " kPa", ""), strict=True):
            own = site["population"][key]
            if own["beyond_family"]:
                reported.append(f"{key} {own['beyond_family']}")
                continue
            reported.append(
                f"{key.removesuffix('_kpa')} {own['geometric_mean']:.3g}{unit} (x/÷ "
                f"{own['spread_factor']:.2f})"
            )
        lines.append(f"{name}: {site['n_rows']} rows, {', '.join(reported)}")
    mean_error = data["compliance_left_out"]["mean_absolute_difference_percent"]
    if mean_error is not None:
        low, high = data["compliance_left_out"]["interval_95_percent"]
        lines.append(
            f"compliance of held-out people, from thicknesses: {mean_error:.1f} % off on average ({low:.1f} "
            f"to {high:.1f} with other people)"
        )
    standing = data["stands_out"]
    lines.append(f"{len(standing['rows'])} rows and {len(standing['people'])} people stand out")
    lines.append(f"page: {page}")
    return lines
