"""Wave speeds of any law against the closed form, and forces by the envelope theorem."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.effects.frozen import Kinematics, frozen_force
from limbcli.effects.waves import log_speed
from limbcli.materials.ogden import ogden_type
from limbcli.measurement.acoustoelasticity import OgdenTerms, wave_speed_m_per_s
from limbcli.model import Block, Domain, LimbModel, Material, Mesh


def _model(material: Material) -> LimbModel:
    points = np.vstack([np.zeros(3), np.eye(3)])
    mesh = Mesh(points, (Block("tissue", "tet4", np.array([[0, 1, 2, 3]] * 5)),))
    return LimbModel(mesh, {"tissue": material}, (Domain("tissue", "tissue"),))


def _gradients(rng) -> np.ndarray:
    return np.eye(3) + 0.15 * rng.standard_normal((5, 3, 3))


def test_ogden_speed_is_the_closed_form(rng):
    F, law = _gradients(rng), ogden_type(c=0.006, f_kappa=100.0, m=5.0)
    closed = wave_speed_m_per_s(F, OgdenTerms.of(law), mode="polarised")
    found = np.exp(log_speed(_model(law), "tissue", F, np.arange(5)))
    assert found == pytest.approx(closed, rel=2e-4)


def test_fibre_along_the_wave_adds_half_its_shear_modulus():
    law = ogden_type(c=0.006, f_kappa=100.0, m=2.0)
    fibre = {"ksi": 0.0, "alpha": 0.0, "beta": 2.0, "mu": 0.004, "lam0": 1.0, "fiber": (1.0, 0.0, 0.0)}
    mixed = Material("mixture", {}, (law, Material("fiber_exp_pow", fibre)))
    F = np.repeat(np.diag([1.0005, 1.0, 1.0])[None], 5, axis=0)  # fibres work in tension only
    speed = np.exp(log_speed(_model(mixed), "tissue", F, np.arange(5)))
    assert 1000 * speed[0] ** 2 * 1e-6 == pytest.approx(0.003 + 0.002, rel=0.01)


def test_frozen_force_of_a_uniform_squeeze_is_exact():
    """One cell squeezed without bulging of volume: F = dE/d(depth) by hand."""
    law = ogden_type(c=0.006, f_kappa=100.0, m=2.0)
    depth = np.linspace(0, 4, 17)
    stretch = 1 - depth / 10
    F = np.array([np.diag([s**-0.5, s**-0.5, s]) for s in stretch])[:, None]
    volume = np.array([1000.0])
    model = _model(law)
    found = frozen_force(model, Kinematics(depth, F, volume))
    # W = c/8 (sum l^2 + l^-2 - 6), dW/ds = c/8 (2 s - 2 s^-2 - 2 s^-3 + 2), ds/ddepth = -1/10
    s = stretch
    exact = -100.0 * 0.006 / 8 * (2 * s - 2 * s**-2 - 2 * s**-3 + 2)
    assert found[2:-2] == pytest.approx(exact[2:-2], rel=1e-3)
