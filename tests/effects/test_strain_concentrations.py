"""Speeds of a deformation with a stiff region in it: what is strained less stiffens less."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from limbcli.effects import frozen_deformation
from limbcli.effects.frozen_deformation import (
    ScannerView,
    SolvedDeformation,
    StrainConcentration,
    frozen_speed,
    strain_concentrations,
)
from limbcli.effects.stiffness_places import Places, cell_means
from tests.diagnosis.reduced import block_model

MODEL = block_model()
CELLS = MODEL.mesh.blocks[0].cells
MIDDLES = MODEL.mesh.points[CELLS].mean(axis=1)


class Every:
    """Averages of pixels that are single cells."""

    index = np.arange(len(CELLS))[:, None]

    def __call__(self, values: np.ndarray) -> np.ndarray:
        return values


def stiff(places: Places) -> np.ndarray:
    """Four times as stiff in a ball under the middle."""
    return 1.0 + 3.0 * (np.linalg.norm(places.at - [0.0, 0.0, -15.0], axis=-1) < 9.0)


def deformed(*stretches: np.ndarray) -> SolvedDeformation:
    gradient = np.broadcast_to(np.eye(3), (len(stretches), len(CELLS), 1, 3, 3)).copy()
    gradient[..., 0, 2, 2] = stretches
    view = ScannerView(Every(), Places(MIDDLES[:, None, :], MODEL), np.ones(1), np.log)
    depth = np.arange(float(len(stretches)))
    volume = np.full((len(CELLS), 1), 2.0)
    return SolvedDeformation(depth, gradient, MIDDLES[:, None], volume, (view,) * len(stretches))


@pytest.fixture
def speeds_of_stretch(monkeypatch):
    """ln speed is the stretch along the beam."""
    monkeypatch.setattr(
        frozen_deformation,
        "block_speeds",
        lambda model, name, F, cells, density_kg_per_m3: np.exp(F[:, 2, 2]),
    )


def test_the_slope_is_that_of_a_strain_in_proportion_to_each_cells_part(speeds_of_stretch):
    """Beside a plane across the image and what two deformations without it have between them."""
    x, _, z = MIDDLES.T
    part = cell_means(MODEL, stiff) - 1.0
    low, high = 0.9 + 0.001 * z, 0.7 - 0.002 * z + 0.02 * part
    base = 0.25 * low + 0.75 * high + 0.01 + 0.0005 * x
    found = strain_concentrations(
        MODEL, deformed(base, base - 0.06 * part), [(0.25, deformed(low, low)), (0.75, deformed(high, high))],
        [stiff], density_kg_per_m3=1000.0,
    )  # fmt: skip
    assert [each.slope for each in found] == pytest.approx([0.0, -0.06], abs=1e-9)
    assert found[1].factor == pytest.approx(part + 1.0)


def test_deformations_of_other_cells_tell_nothing(speeds_of_stretch):
    other = SolvedDeformation(np.zeros(1), np.zeros((1, 3, 1, 3, 3)), np.zeros((3, 1, 3)), np.ones((3, 1)))
    flat = deformed(np.ones(len(CELLS)))
    assert strain_concentrations(MODEL, flat, [(1.0, other)], [stiff], density_kg_per_m3=1000.0) == ()


def test_a_pixel_in_a_cell_that_is_filled_in_part_is_read_as_what_is_there(speeds_of_stretch):
    """The speed of a cell that a region fills in part is neither that of the region nor that beside it."""
    part = cell_means(MODEL, stiff) - 1.0
    mixed = (part > 0.1) & (part < 2.9)
    assert mixed.sum() > 20
    deformation = deformed(0.8 - 0.05 * part)
    there = 0.8 - 0.05 * (stiff(SimpleNamespace(at=MIDDLES)) - 1.0)
    expected = there + 0.5 * np.log(stiff(SimpleNamespace(at=MIDDLES)))
    plain = frozen_speed(MODEL, deformation, [stiff], density_kg_per_m3=1000.0)[0]
    assert np.abs(plain - expected)[mixed].max() > 0.05
    concentrations = [StrainConcentration(part + 1.0, -0.05)]
    found = frozen_speed(
        MODEL, deformation, [stiff], density_kg_per_m3=1000.0, concentrations=concentrations
    )[0]
    assert found == pytest.approx(expected, abs=1e-9)
