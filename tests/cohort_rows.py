"""Tables of cohorts for tests: people whose tissue is known, answered by the emulator or by stored solves."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from limbcli.cohorts.population import CohortModel, tissue
from limbcli.inference.layered_family import FORCE, SKIN_PART, layered_family

HEADER = (
    "subject",
    "location",
    "max_force_n",
    "face_mm2",
    "thickness_mm",
    "skin_mm",
    "fat_mm",
    "muscle_mm",
    "total_strain",
    "skin_strain",
    "fat_strain",
    "muscle_strain",
    "stiffness_mpa_per_mm",
)
FACE = 675.0


def people(
    n: int, *, mean: np.ndarray, spread: np.ndarray, rng: np.random.Generator, noise_mm: float = 0.05
) -> tuple[list[dict[str, str]], np.ndarray]:
    """Rows of n people at one site, and their ln c_muscle (MPa), ln c_fat (MPa), ln m (n, 3)."""
    theta = mean + rng.multivariate_normal(np.zeros(3), spread, n)
    skin, fat, muscle = rng.uniform(1.0, 2.0, n), rng.uniform(3.0, 15.0, n), rng.uniform(20.0, 45.0, n)
    thickness = np.column_stack([skin, fat, muscle])
    strain = rng.uniform(0.12, 0.28, n)
    whole = thickness.sum(axis=1)
    model = CohortModel.of(layered_family(), thickness, np.full(n, FACE), strain)
    seen, _ = model(theta, False)
    assert np.isfinite(model.of_tissue(tissue(theta))[0][:, [FORCE, SKIN_PART]]).all()
    depth = strain * whole
    below = depth * (1 - model.skin_part(theta))
    parts = np.column_stack([depth - below, below * seen[:, 2], below * (1 - seen[:, 2])])
    parts += rng.normal(0.0, noise_mm, parts.shape)
    force = np.exp(seen[:, 0]) * FACE * strain * np.exp(rng.normal(0.0, 0.02, n))
    slope = force / FACE / depth / np.exp(seen[:, 1] + rng.normal(0.0, 0.03, n))
    return [row(f"P{k:03d}", "LL_P", force[k], thickness[k], parts[k], slope[k]) for k in range(n)], theta


def row(
    subject: str, location: str, force: float, thickness: np.ndarray, shortened: np.ndarray, slope: float
) -> dict[str, str]:
    strain = shortened / thickness
    values = (
        force,
        FACE,
        thickness.sum(),
        *thickness,
        shortened.sum() / thickness.sum(),
        *strain,
        slope,
    )
    return dict(zip(HEADER, (subject, location, *(f"{each:.9g}" for each in values)), strict=True))


def written(path: Path, rows: list[dict[str, str]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return path
