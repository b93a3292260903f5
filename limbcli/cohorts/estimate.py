"""Estimates for the sites of a cohort's table: noise, population, and the tissue of each row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from limbcli.cohorts.population import (
    PRIOR_DEVIATION,
    START,
    CohortModel,
    reading_noise,
    readings,
    slope_noise,
)
from limbcli.cohorts.table import CohortTable
from limbcli.inference.layered_family import LayeredFamily
from limbcli.inference.population import Population, Rows, estimate_population
from limbcli.measurement.edge_noise import EdgeNoise, layer_noise
from limbcli.model import Array, IntArray
from limbcli.progress import SILENT, Progress


@dataclass(frozen=True, eq=False, kw_only=True)
class SiteEstimate:
    """One site's rows (indices in the table), their model and the estimates."""

    name: str
    rows: IntArray
    model: CohortModel
    readings: Array
    noise: Array
    population: Population
    found: Rows


@dataclass(frozen=True, eq=False)
class CohortNoise:
    """Noise of the table: of the layers' shortening (mm), and of ln stiffness."""

    layers: EdgeNoise
    slope: float
    slope_from_data: bool


def noise_of(table: CohortTable) -> CohortNoise:
    """The noise estimated from the table itself."""
    convexity = np.log(table.force / table.face / table.depth / table.slope)
    one, two = (table.others.get(name) for name in ("r2_line", "r2_parabola"))
    slope, reported = slope_noise(convexity, one, two)
    return CohortNoise(layer_noise(table.shortened), slope, reported)


def estimate_sites(
    table: CohortTable,
    family: LayeredFamily,
    noise: CohortNoise,
    *,
    seed: int = 7,
    progress: Progress = SILENT,
) -> list[SiteEstimate]:
    """Estimate the population of every site and the tissue of its rows.

    Rows are sorted by person and trial, so that the random draws do not depend on their order in the table.
    """
    found = []
    named = np.lexsort((table.trial.astype(str), table.person.astype(str)))
    for k, site in enumerate(table.sites):
        rows = named[table.site[named] == site]
        part = table.rows(rows)
        model = CohortModel.of(family, part.thickness, part.face, part.depth / part.whole)
        seen = readings(part.force, part.face, part.whole, part.shortened, part.slope)
        covariance = reading_noise(part.shortened, noise.layers.shortened, noise.slope, family.error)
        population, own = estimate_population(
            model, seen, covariance, start=START, prior_deviation=PRIOR_DEVIATION, people=part.person,
            seed=seed,
        )  # fmt: skip
        found.append(SiteEstimate(
            name=site, rows=rows, model=model, readings=seen, noise=covariance, population=population,
            found=own,
        ))  # fmt: skip
        progress.event("task", name="sites", done=k + 1, total=len(table.sites))
    return found
