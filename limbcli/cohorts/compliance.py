"""Prediction error of the compliance of held-out people, and the part of it that no model can remove."""

from __future__ import annotations

from typing import Any

import numpy as np

from limbcli.cohorts.estimate import noise_of
from limbcli.cohorts.population import PRIOR_DEVIATION, START, CohortModel, reading_noise, readings
from limbcli.cohorts.table import OF_PERSON, CohortTable
from limbcli.inference.cross_validation import (
    FOLDS,
    lines_left_out,
    mean_interval,
    percent_off,
    predict_left_out,
    springs_left_out,
)
from limbcli.inference.layered_family import LayeredFamily
from limbcli.inference.population import row_modes
from limbcli.model import Array

_PAIRS = 8  # least number of repeated measurements for which repeatability is reported
_OFF_OF_GAUSSIAN = np.sqrt(2.0 / np.pi)  # mean absolute value of a standard normal variable


def compliance_left_out(
    table: CohortTable, family: LayeredFamily, slope_deviation: float, layer_deviation: Array, *, seed: int
) -> tuple[dict[str, Any], list[str]]:
    """The entry of cohort.json, and warnings.

    slope_deviation, layer_deviation : noise of all rows, from which repeatability is estimated
    """
    n_people = len(table.people)
    if n_people < FOLDS:
        why = f"{n_people} people are too few for {FOLDS} folds by person"
        empty: dict[str, Any] = {
            "mean_absolute_difference_percent": None,
            "reason": why,
            "folds": {},
            "rows": [],
        }
        return empty, [f"{why}: the compliance of held-out people is not predicted"]
    physics = _Slab(table, family)
    features = np.column_stack([np.log(table.thickness), np.log(table.whole), np.log(table.face)])
    people, sites, measured = table.person, table.site, table.compliance
    found = predict_left_out(people, sites, features, measured, physics, seed=seed)
    off = percent_off(found.predicted, measured)
    soft, worst = table.thickness[:, 1:], int(np.argmax(off))
    nothing = np.zeros((len(measured), 0))
    others = {
        "springs_in_series_percent": springs_left_out(people, soft, measured, seed=seed),
        "linear_site_by_site_percent": lines_left_out(people, sites, soft, measured, seed=seed),
        "sites_mean_percent": lines_left_out(people, sites, nothing, measured, seed=seed),
    }
    entry: dict[str, Any] = {
        "mean_absolute_difference_percent": float(off.mean()),
        "interval_95_percent": list(mean_interval(people, off, seed=seed)),
        "standard_deviation_percent": float(off.std()),
        "median_absolute_difference_percent": float(np.median(off)),
        "largest_row": {
            "subject": str(people[worst]),
            "location": str(sites[worst]),
            "difference_percent": float(off[worst]),
            "share_of_the_mean_percent": float(off[worst] / len(off)),
        },
        "predicted_from": ["location", "skin_mm", "fat_mm", "muscle_mm", "thickness_mm", "probe's face"],
        "n_folds": FOLDS,
        "seed": seed,
        "by_site_percent": {site: float(off[sites == site].mean()) for site in table.sites},
        "with_person_columns": _with_person(table, features, physics, seed),
        "same_folds": {name: float(percent_off(each, measured).mean()) for name, each in others.items()},
        "repeatability": _repeatability(table, slope_deviation, layer_deviation),
        "person_share_of_residual_variance": _person_share(table, np.log(measured / found.predicted)),
        "chosen": list(found.chosen),
        "folds": {str(p): int(found.fold[np.flatnonzero(people == p)[0]]) for p in table.people},
        "rows": [
            {
                "subject": str(people[k]),
                "location": str(sites[k]),
                "line": int(table.lines[k]),
                "fold": int(found.fold[k]),
                "measured_mm_per_mpa": float(measured[k]),
                "predicted_mm_per_mpa": float(found.predicted[k]),
                "difference_percent": float(off[k]),
            }
            for k in range(len(table))
        ],
    }
    return entry, []


class _Slab:
    """ln compliance of the slab with the mean tissue of the training people, for each site.

    The tissue of each training row is identified with the same fixed prior, so that rows are coupled only
    through the noise estimated from all of them. A fold's mean tissue and typical strain at a site are those
    of its training rows.
    """

    def __init__(self, table: CohortTable, family: LayeredFamily):
        self._table, self._family = table, family
        self._strain = table.depth / table.whole

    def _tissue(self, train: Array) -> Array:
        """theta (n, 3) of the training rows, with the noise estimated from them; NaN for the other rows."""
        part = self._table.rows(train)
        noise = noise_of(part)
        model = CohortModel.of(self._family, part.thickness, part.face, part.depth / part.whole)
        seen = readings(part.force, part.face, part.whole, part.shortened, part.slope)
        theta = np.full((len(self._table), 3), np.nan)
        covariance = reading_noise(part.shortened, noise.layers.shortened, noise.slope, self._family.error)
        theta[train] = row_modes(model, seen, covariance, START, np.diag(PRIOR_DEVIATION**2))
        return theta

    def __call__(self, train: Array) -> Array:
        out, tissue = np.empty(len(self._table)), self._tissue(train)
        for site in self._table.sites:
            here = self._table.site == site
            known = here & train if (here & train).any() else train
            theta = np.tile(tissue[known].mean(axis=0), (int(here.sum()), 1))
            strain = np.full(len(theta), np.median(self._strain[known]))
            part = self._table.rows(here)
            model = CohortModel.of(self._family, part.thickness, part.face, strain)
            out[here] = np.log(part.whole) - model.log_slope(theta)
        return out


def _with_person(table: CohortTable, features: Array, physics: _Slab, seed: int) -> dict[str, Any] | None:
    """The same prediction with the columns about the person; None if the table does not have them."""
    columns, names = [], []
    for name in OF_PERSON:
        values = table.others.get(name)
        if values is not None and np.isfinite(values).all():
            columns.append(values)
            names.append(name)
    kinds = sorted(set(table.sex.tolist()))
    if len(kinds) == 2 and "" not in kinds:
        columns.append((table.sex == kinds[1]).astype(float))
        names.append("sex")
    if not columns:
        return None
    more = np.column_stack([features, *columns])
    found = predict_left_out(table.person, table.site, more, table.compliance, physics, seed=seed)
    off = percent_off(found.predicted, table.compliance)
    return {"columns": names, "mean_absolute_difference_percent": float(off.mean())}


def _repeatability(table: CohortTable, slope_deviation: float, layer_deviation: Array) -> dict[str, Any]:
    """Repeatability of the compliance: from repeated trials if there are enough, and from the noise of layer
    marks and slope alone."""
    marks = layer_deviation.max() / table.depth
    deviation = np.sqrt(slope_deviation**2 + marks**2)
    entry: dict[str, Any] = {
        "percent_from_marks_and_slope_alone": float(100 * _OFF_OF_GAUSSIAN * deviation.mean()),
        "percent_from_trials": None,
        "n_repeated": 0,
    }
    groups: dict[tuple[str, str], list[int]] = {}
    for k, key in enumerate(zip(table.person.astype(str), table.site.astype(str), strict=True)):
        groups.setdefault(key, []).append(k)
    repeated = [np.log(table.compliance[each]) for each in groups.values() if len(each) > 1]
    entry["n_repeated"] = len(repeated)
    if len(repeated) < _PAIRS:
        entry["reason"] = (
            f"{len(repeated)} sites of a person were measured more than once; trials of the same person and "
            "site are needed to assess repeatability"
        )
        return entry
    free = sum(len(each) - 1 for each in repeated)
    within = np.sqrt(sum(float(np.sum((each - each.mean()) ** 2)) for each in repeated) / free)
    entry["percent_from_trials"] = float(100 * _OFF_OF_GAUSSIAN * within)
    return entry


def _person_share(table: CohortTable, residual: Array) -> float | None:
    """Share of the residuals' variance common to a person's sites (0: sites are independent).

    Repeated trials at one site of a person are replaced by their mean.
    """
    groups: dict[tuple[str, str], list[float]] = {}
    for each, *key in zip(residual, table.person.astype(str), table.site.astype(str), strict=True):
        groups.setdefault((key[0], key[1]), []).append(float(each))
    people, sites = np.array(list(groups)).T
    centred = np.array([np.mean(each) for each in groups.values()])
    for site in table.sites:
        here = sites == str(site)
        centred[here] -= centred[here].mean()
    products: list[float] = []
    for person in sorted(set(people.tolist())):
        own = centred[people == person]
        if len(own) > 1:
            total = float(own.sum() ** 2 - np.sum(own**2))
            products += [total / (len(own) * (len(own) - 1))] * (len(own) - 1)
    if len(products) < _PAIRS:
        return None
    return float(np.mean(products) / np.mean(centred**2))
