"""Wave speeds of a simulation's levels are read at the integration points of the recorded elements."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.model import Array, IntArray
from limbcli.shear_waves.from_simulation import AT_REST, PointStates, level_maps
from limbcli.shear_waves.ogden import OgdenTerms
from limbcli.shear_waves.pixels import Window
from limbcli.shear_waves.speed import wave_speed_m_per_s
from limbcli.solvers.solver import Simulation, Table
from tests.stages.block_case import block_model

MODEL = block_model("tet10", counts=(6, 4, 3))
CELLS = np.array([7, 3, 40, 41])
TIMES = np.array([0.5, 1.0])


def bent(x: Array) -> Array:
    """A displacement (..., 3), quadratic in height: shorter by 20 % at the bottom, by a half at the top."""
    z = x[..., 2]
    return np.stack([0.2 * x[..., 0], 0.1 * x[..., 1], -0.5 * z - 0.3 / 32 * z**2], axis=-1)


def gradient_of_bent(x: Array) -> Array:
    F = np.zeros((*x.shape[:-1], 3, 3))
    F[..., 0, 0], F[..., 1, 1] = 1.2, 1.1
    F[..., 2, 2] = 0.5 - 0.3 / 16 * x[..., 2]
    return F


def simulation(nodes: IntArray, cells: IntArray = CELLS) -> Simulation:
    """Half of it at the first time, all of it at the second."""
    moved = np.array([0.5, 1.0])[:, None, None] * bent(MODEL.mesh.points[nodes])
    return Simulation(
        "none", "0", TIMES, {},
        nodes={"nodes.csv": Table(("ux", "uy", "uz"), TIMES, nodes, moved)},
        elements={"elements.csv": Table(("J",), TIMES, cells, np.ones((2, len(cells), 1)))},
    )  # fmt: skip


EVERY_NODE = np.unique(MODEL.mesh.block("tissue").cells)
EVERY_CELL = np.arange(len(MODEL.mesh.block("tissue").cells))


def test_deformation_is_exact_at_the_points_where_it_is_quadratic_over_a_cell():
    states = PointStates.of(MODEL, simulation(EVERY_NODE))
    assert states.items.tolist() == np.repeat(CELLS, 4).tolist()
    positions, F = states.at(1)
    assert positions == pytest.approx(states.rest + bent(states.rest), abs=1e-12)
    assert pytest.approx(gradient_of_bent(states.rest), abs=1e-12) == F
    at_rest, identity = states.at(AT_REST)
    assert at_rest is states.rest
    assert np.abs(identity - np.eye(3)).max() == 0.0


def test_a_map_shows_the_speed_of_the_strain_at_its_pixels():
    """Within 0.1 % or so; read at the cells' means three times as far off."""
    found = level_maps(
        MODEL, simulation(EVERY_NODE, EVERY_CELL), [1], density_kg_per_m3=1000.0,
        window=Window(half_width=8.0, depth_from=2.0, depth_to=8.0, smoothing=1.5),
        face_depths=np.zeros(2),
    )[0]  # fmt: skip
    # heights z of the pixels' tissue unloaded: -depth = 0.5 z - 0.3 / 32 z^2
    z = (0.5 - np.sqrt(0.25 + 4 * 0.3 / 32 * found.depth)) / (2 * 0.3 / 32)
    terms = OgdenTerms.of(MODEL.materials["tissue"])
    assert terms is not None
    exact = wave_speed_m_per_s(
        gradient_of_bent(np.column_stack([np.zeros_like(z), np.zeros_like(z), z])), terms
    )
    off = np.log(found.speed_m_per_s / exact)
    assert len(off) == 119
    assert np.sqrt(np.mean(off**2)) < 0.002


def test_nodes_that_were_not_recorded_are_told():
    with pytest.raises(MeasurementError, match="did not record the displacements of all nodes"):
        PointStates.of(MODEL, simulation(EVERY_NODE[:-200]))
    with pytest.raises(MeasurementError, match="did not record elements"):
        PointStates.of(MODEL, simulation(EVERY_NODE, CELLS[:0]))
