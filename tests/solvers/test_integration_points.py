"""Deformation at the points where cells are integrated, and what a diagnosis reads there."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.diagnosis.curves.site_simulations import SiteSimulations
from limbcli.diagnosis.data.windows import Windows
from limbcli.effects.frozen_deformation import SolvedDeformation
from limbcli.shear_waves.speed import block_speeds
from limbcli.solvers.integration_points import IntegrationPoints
from tests.stages.block_case import block_model

QUADRATIC = block_model("tet10", counts=(4, 2, 2))
POINTS = IntegrationPoints.of(QUADRATIC.mesh.points, QUADRATIC.mesh.block("tissue"))


def bent(x: np.ndarray) -> np.ndarray:
    """A displacement (..., 3) that is quadratic in place."""
    z = x[..., 2]
    return np.stack([0.1 * x[..., 0], 0.002 * x[..., 1] * z, 0.01 * z**2 - 0.1 * z], axis=-1)


def gradient_of_bent(x: np.ndarray) -> np.ndarray:
    F = np.zeros((*x.shape[:-1], 3, 3))
    F[..., 0, 0] = 1.1
    F[..., 1, 1] = 1 + 0.002 * x[..., 2]
    F[..., 1, 2] = 0.002 * x[..., 1]
    F[..., 2, 2] = 0.9 + 0.02 * x[..., 2]
    return F


def test_quadratic_cells_tell_a_quadratic_displacement_exactly_at_every_point():
    u = bent(QUADRATIC.mesh.points)
    assert POINTS.gradients(u) == pytest.approx(gradient_of_bent(POINTS.rest), abs=1e-12)
    assert POINTS.places(u) == pytest.approx(POINTS.rest + bent(POINTS.rest), abs=1e-12)


@pytest.mark.parametrize(("element", "n"), [("tet4", 1), ("tet10", 4)])
def test_volumes_and_middles_are_those_of_the_block(element, n):
    model = block_model(element, counts=(4, 2, 2))
    found = IntegrationPoints.of(model.mesh.points, model.mesh.block("tissue"))
    assert found.volume.shape[1] == n
    assert found.volume.sum() == pytest.approx(48 * 36 * 16)
    middle = np.einsum("cq,cqi->i", found.volume, found.rest) / found.volume.sum()
    assert middle == pytest.approx([0.0, 0.0, -8.0], abs=1e-9)


def deformation() -> SolvedDeformation:
    windows = Windows(-8.0, 8.0, 2.0, 10.0, 4, 2)
    made = SiteSimulations(QUADRATIC, [1.0, 2.0], c=0.006, windows=windows)
    values = np.array([[0.5], [1.0]])[:, :, None] * bent(QUADRATIC.mesh.points[made.nodes])
    return made.deformation(QUADRATIC, np.array([0.0, 1.0, 2.0]), values)


def test_speeds_are_read_at_the_points_and_not_at_the_cells_means():
    """Where the speed bends with strain, that of the mean strain is another one."""
    found = deformation()
    points = np.arange(found.volume.size)
    speed = found.point_speeds(2, QUADRATIC, points, density_kg_per_m3=1000.0)
    exact = block_speeds(
        QUADRATIC, "tissue", gradient_of_bent(POINTS.rest.reshape(-1, 3)), points // 4,
        density_kg_per_m3=1000.0,
    )  # fmt: skip
    assert speed == pytest.approx(exact, rel=1e-9)
    F = gradient_of_bent(POINTS.rest).mean(axis=1)
    of_means = block_speeds(QUADRATIC, "tissue", F, np.arange(len(F)), density_kg_per_m3=1000.0)
    assert np.abs(speed.reshape(-1, 4).mean(axis=1) / of_means - 1).max() > 0.002


def test_energies_are_integrals_over_the_cells():
    """By the law's own formula at the points."""
    found = deformation()
    energies = found.cell_energies(QUADRATIC)[2]
    material = QUADRATIC.materials["tissue"].parameters
    c, m, kappa = 2 * material["c1"], material["m1"], material["kappa"]
    F = gradient_of_bent(POINTS.rest)
    squares = np.linalg.eigvalsh(np.swapaxes(F, -1, -2) @ F)
    law = c / (2 * m**2) * (squares ** (m / 2) + squares ** (-m / 2) - 2).sum(axis=-1)
    law += kappa / 2 * (np.linalg.det(F) - 1) ** 2
    assert energies == pytest.approx((law * POINTS.volume).sum(axis=1), rel=1e-9)
