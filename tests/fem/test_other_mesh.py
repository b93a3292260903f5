"""First guesses from the levels of a solve on another mesh."""

from __future__ import annotations

import numpy as np
import pytest
from small_models import block, punch

from limbcli.errors import CaseError
from limbcli.fem.other_mesh import OtherMesh
from limbcli.fem.system import System
from limbcli.solvers.session import ReferenceSession

COARSE, FINE, SIZE = (2, 2, 2), (3, 5, 4), (2.0, 1.0, 1.5)


@pytest.fixture
def system():
    made = System(block("tet10", FINE, SIZE), threads=1)
    yield made
    made.close()


def coarse(bent):
    """A coarse block whose nodes moved by `bent` of their places, at time 0.5."""
    model = block("tet10", COARSE, SIZE)
    made = OtherMesh.of(model, {0.5: bent(model.mesh.points)})
    assert made is not None
    return made


def test_what_is_quadratic_is_met_exactly(system: System, rng: np.random.Generator) -> None:
    matrix = rng.standard_normal((3, 6))

    def bent(X):
        x, y, z = X.T
        return 0.01 * np.stack([x, y**2, x * z, z, y * z, x**2], axis=1) @ matrix.T

    guess = coarse(bent).guess(system, 0.5)
    assert guess is not None
    np.testing.assert_allclose(guess.u, bent(system.X), atol=1e-13)


def test_volume_ratios_are_those_of_an_even_deformation(system: System, rng: np.random.Generator) -> None:
    gradient = 0.1 * rng.standard_normal((3, 3))
    guess = coarse(lambda X: X @ gradient.T).guess(system, 0.5)
    assert guess is not None
    expected = np.linalg.det(np.eye(3) + gradient)
    for ratios, group in zip(guess.volumes, system.groups, strict=True):
        np.testing.assert_allclose(ratios, np.full(group.weight.shape, expected), rtol=1e-12)


def test_what_lies_outside_moves_as_the_border_does(system: System) -> None:
    other = coarse(lambda X: 0.1 * X)
    other = OtherMesh(other.points - [0.0, 0.0, 0.2], other.cells, other.displacements)
    guess = other.guess(system, 0.5)
    assert guess is not None
    above = system.X[:, 2] > -0.2 + 1e-9
    assert above.any()
    np.testing.assert_allclose(guess.u[above, 2], 0.0, atol=1e-9)  # as the top, which stayed


def test_only_levels_that_were_solved(system: System) -> None:
    assert coarse(np.zeros_like).guess(system, 0.25) is None


def test_displacements_of_another_number_of_nodes_are_refused() -> None:
    model = punch("tet4")
    with (
        ReferenceSession(model, threads=1) as session,
        pytest.raises(CaseError, match="of a mesh whose nodes are"),
    ):
        session.begin_beside(model, {0.5: np.zeros((3, 3))})


def test_other_cells_than_tetrahedra_lead_nowhere() -> None:
    model = block("hex8", COARSE, SIZE)
    assert OtherMesh.of(model, {0.5: np.zeros_like(model.mesh.points)}) is None
