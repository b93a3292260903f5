"""Fibres whose shear term jumps: the tangent is not symmetric, and is exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import block

from limbcli.fem.equilibrium.tangent import assemble
from limbcli.fem.system import System
from limbcli.materials import ogden_type
from limbcli.materials.fiber import JUMP
from limbcli.model import Material
from limbcli.model.bodies import Drive, RigidBody


@pytest.mark.slow
def test_tangent_agrees_with_differences_on_the_jump(rng: np.random.Generator) -> None:
    """Cells within the band, some of them tied to a free plate."""
    fibre = Material("fiber_exp_pow", {"ksi": 0.003, "mu": 0.004, "fiber": (0.0, 0.8, 0.6)})
    tissue = Material("mixture", {}, (ogden_type(c=0.005, f_kappa=2.0, m=2.0), fibre))
    model = block("tet4", (2, 2, 2), material=tissue)
    plate = RigidBody("plate", (0.5, 0.5, 0.0), node_sets=("z1",))
    drives = (Drive("plate", "z", "force", 0.001, "ramp"),)
    system = System(replace(model, bodies=(plate,), drives=drives), threads=1)
    shear = np.zeros_like(system.X)
    shear[:, 0] = 0.1 * (0.8 * system.X[:, 1] + 0.6 * system.X[:, 2])  # I4 = 1.01
    state = system.rest()
    state = system.followed(replace(state, u=shear - 0.005 * system.X))
    state = system.moved(state, 2e-5 * rng.standard_normal(system.n_unknowns))
    a = np.array((0.0, 0.8, 0.6))
    F = np.eye(3) + np.einsum("cgnj,cni->cgij", system.groups[0].grad, state.u[system.groups[0].cells])
    I4 = ((F @ a) ** 2).sum(axis=2)
    assert ((I4 > 1) & (I4 < 1 + JUMP)).sum() > 5
    forces = system.forces(state)
    tangent = assemble(system, state, forces.nodal)
    assert tangent.jumps
    direction = rng.standard_normal(system.n_unknowns)
    exact = tangent.times(forces.contact, direction)
    h = 1e-8
    up, down = (system.forces(system.moved(state, s * h * direction)).residual for s in (1, -1))
    np.testing.assert_allclose((up - down) / (2 * h), exact, atol=1e-5 * abs(exact).max())
