"""A quadratic cell may turn inside out though none of its integration points does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import block

from limbcli.fem.equilibrium.newton import Newton, NotConverged
from limbcli.fem.equilibrium.settings import LoadStep, Settings
from limbcli.fem.record_fields import gauss_fields
from limbcli.fem.system import System
from limbcli.materials import ogden_type

# of the ten nodes of the first cell, mm: each integration point is upright, the mean is not
_BENT = np.array(
    [[-0.8, -0.4, -0.4], [0.9, 0.7, 1.2], [-0.1, -0.1, 0.1], [-0.7, 0.7, -1.1], [-1.1, -0.6, -1.4],
     [-0.7, 1.1, -1.1], [0.2, 1.0, 0.1], [0.1, 0.3, 0.3], [-0.3, 0.7, 0.1], [-0.4, -0.5, 0.2]]
)  # fmt: skip


@pytest.fixture
def system():
    made = System(block("tet10", (1, 1, 1), material=ogden_type(c=0.008, f_kappa=5.0, m=2.0)), threads=1)
    yield made
    made.close()


def test_mean_volume_is_that_of_the_mean_gradient(system: System, rng: np.random.Generator) -> None:
    state = replace(system.rest(), u=0.05 * rng.standard_normal(system.X.shape))
    F, _ = gauss_fields(system, state, 0)
    expected = np.linalg.det(F.mean(axis=1))
    worst, (group, cell) = system.smallest_mean_volume(state)
    assert worst == pytest.approx(expected.min(), rel=1e-12)
    assert (group, cell) == (0, expected.argmin())


def test_an_equilibrium_with_such_a_cell_is_refused(system: System) -> None:
    u = np.zeros_like(system.X)
    u[system.groups[0].cells[0]] = _BENT
    state = replace(system.rest(), u=u)
    F, _ = gauss_fields(system, state, 0)
    assert (np.linalg.det(F[0]) > 0).all()
    assert np.linalg.det(F[0].mean(axis=0)) < 0
    solver, at_rest = Newton(system, Settings(threads=1)), system.forces(system.rest())
    with pytest.raises(NotConverged, match="inverted"):
        solver.accepted(replace(at_rest, contact=system.search(state)), LoadStep(1, 1, 0.0), 3)
    kept, _ = solver.accepted(at_rest, LoadStep(1, 1, 0.0), 0)
    assert not kept.u.any()
