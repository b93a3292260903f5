"""Waves in deformed tissue of any law, against energies written here and differentiated by steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from limbcli.materials import ogden_type
from limbcli.model import Curved, ElementMap, Material
from limbcli.shear_waves.any_law import acoustic_tensor
from limbcli.shear_waves.ogden import OgdenTerms
from limbcli.shear_waves.ogden import acoustic_tensor as ogden_tensor
from limbcli.shear_waves.speed import shear_speed_m_per_s, wave_speed_m_per_s

X, Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
# Eighth-order central second difference.
STENCIL = {0: -205 / 72, 1: 8 / 5, 2: -1 / 5, 3: 8 / 315, 4: -1 / 560}
MU, LAMBDA, BETA = 0.004, 0.16, 0.35
FIBRE = np.array([0.8, 0.0, 0.6])


def neo_hooke(F):
    J, I1 = np.linalg.det(F), np.sum(F * F)
    return MU / 2 * (I1 - 3) - MU * np.log(J) + LAMBDA / 2 * np.log(J) ** 2


def holmes_mow(F):
    C = F.T @ F
    J2, I1 = np.linalg.det(C), np.trace(C)
    I2 = 0.5 * (I1**2 - np.sum(C * C))
    Ha = LAMBDA + 2 * MU
    Q = BETA / Ha * ((2 * MU - LAMBDA) * (I1 - 3) + LAMBDA * (I2 - 3) - Ha * np.log(J2))
    return Ha / (4 * BETA) * (np.exp(Q) - 1)


def fibred(F):
    """Neo-Hooke and fibres that work in tension: ksi 3 kPa, alpha 0.4, beta 2.5, mu 4 kPa."""
    C = F.T @ F
    x = FIBRE @ C @ FIBRE - 1
    if x <= 0:
        return neo_hooke(F)
    sheared = 0.004 / 4 * FIBRE @ (C - np.eye(3)) @ (C - np.eye(3)) @ FIBRE
    return neo_hooke(F) + 0.003 / (0.4 * 2.5) * (np.exp(0.4 * x**2.5) - 1) + sheared


SOFT = Material("neo_hooke", {"mu": MU, "lambda": LAMBDA})
STRANDS = Material(
    "fiber_exp_pow", {"ksi": 0.003, "alpha": 0.4, "beta": 2.5, "mu": 0.004, "fiber": tuple(FIBRE)}
)
LAWS = {
    "neo-Hooke": (SOFT, neo_hooke),
    "Holmes-Mow": (Material("holmes_mow", {"mu": MU, "lambda": LAMBDA, "beta": BETA}), holmes_mow),
    "with fibres": (Material("mixture", {}, (SOFT, STRANDS)), fibred),
}


def curvature(energy, F, a, n, h=3e-3):
    wave = np.outer(a, F.T @ n)
    return sum(STENCIL[abs(k)] * energy(F + k * h * wave) for k in range(-4, 5)) / h**2


def gradients(rng, n=40):
    """Deformed by up to 30 %, the fibre clearly stretched or clearly slack."""
    found = np.eye(3) + 0.3 * rng.uniform(-1, 1, (n, 3, 3))
    stretch = np.linalg.norm(found @ FIBRE, axis=1)
    return found[(np.linalg.det(found) > 0.6) & (np.abs(stretch - 1) > 0.03)]


@pytest.mark.parametrize("law", LAWS)
def test_tensor_of_any_law_is_curvature_of_its_energy(rng, law):
    material, energy = LAWS[law]
    F = gradients(rng)
    assert len(F) > 15
    for each in F:
        n, a = rng.standard_normal((2, 3))
        n /= np.linalg.norm(n)
        Q = acoustic_tensor(material, each[None], n)[0]
        wanted = np.array([curvature(energy, each, e, n) for e in np.eye(3)])
        assert np.diag(Q) == pytest.approx(wanted, rel=1e-6)
        assert a @ Q @ a == pytest.approx(curvature(energy, each, a, n), rel=1e-6)


def test_ogden_by_its_tangent_is_ogden_by_its_closed_form(rng):
    law, F = ogden_type(c=0.006, f_kappa=300.0, m=7.0), gradients(rng)
    assert acoustic_tensor(law, F, X) == pytest.approx(ogden_tensor(F, X, OgdenTerms.of(law)), rel=1e-8)
    speed = shear_speed_m_per_s(acoustic_tensor(law, F, X))
    assert speed == pytest.approx(wave_speed_m_per_s(F, OgdenTerms.of(law)), rel=1e-6, nan_ok=True)


def test_map_gives_each_cell_its_own_speed():
    mu = np.array([0.001, 0.004, 0.009])
    law = Material("neo_hooke", {"mu": ElementMap("mu", "tissue", mu), "lambda": 1.0})
    Q = acoustic_tensor(law, np.stack([np.eye(3)] * 2), X, cells=np.array([2, 0]), n_cells=3)
    assert shear_speed_m_per_s(Q) == pytest.approx([3.0, 1.0])


def test_fibre_along_the_wave_counts_from_rest():
    """At rest a wave along fibres stretches them on either side: mu_f / 2 is added."""
    along = Material("fiber_exp_pow", {**STRANDS.parameters, "fiber": (1.0, 0.0, 0.0)})
    across = Material("fiber_exp_pow", {**STRANDS.parameters, "fiber": (0.0, 1.0, 0.0)})
    rest = np.eye(3)[None]
    stiff, plain = (acoustic_tensor(Material("mixture", {}, (SOFT, e)), rest, X) for e in (along, across))
    assert plain[0, 2, 2] == pytest.approx(MU, rel=5e-3)
    assert stiff[0, 2, 2] == pytest.approx(MU + 0.004 / 2, rel=5e-3)


def test_viscoelastic_law_answers_at_once_and_prestrain_is_in_it(rng):
    F = gradients(rng)[:5]
    slow = Material("viscoelastic", {"g0": 1.0, "g1": 0.5, "t1": 10.0}, (SOFT,))
    assert acoustic_tensor(slow, F, X) == pytest.approx(1.5 * acoustic_tensor(SOFT, F, X))
    taut = np.diag([1.2, 1.0, 0.9])
    law = Material("prestrain", {"F0": tuple(taut.ravel()), "ramp": 1.0}, (SOFT,))

    def energy(F):
        return neo_hooke(F @ taut) / np.linalg.det(taut)

    found = acoustic_tensor(law, F, X)[:, 2, 2]
    assert found == pytest.approx([curvature(energy, each, Z, X) for each in F], rel=1e-6)
    ramped = replace(law, parameters={**law.parameters, "ramp": Curved(1.0, "hold")})
    np.testing.assert_array_equal(acoustic_tensor(ramped, F, X)[:, 2, 2], found)


@pytest.mark.parametrize("ramp", [0.0, 0.4])
def test_a_constant_ramp_is_a_share_of_the_prestrain(rng, ramp):
    F, taut = gradients(rng)[:5], np.diag([1.2, 1.0, 0.9])
    law = Material("prestrain", {"F0": tuple(taut.ravel()), "ramp": ramp}, (SOFT,))
    partly = (1 - ramp) * np.eye(3) + ramp * taut
    whole = Material("prestrain", {"F0": tuple(partly.ravel()), "ramp": 1.0}, (SOFT,))
    np.testing.assert_allclose(acoustic_tensor(law, F, X), acoustic_tensor(whole, F, X), rtol=1e-12)


@pytest.mark.parametrize("squeezed", [1.0, 0.995, 0.98])
def test_the_band_of_a_solver_is_nothing_to_a_wave(squeezed):
    """At rest and soon after, a wave along fibres with a wide band had run as if there were hardly any."""
    along = STRANDS.with_parameters(fiber=(1.0, 0.0, 0.0))
    F = np.diag([squeezed**-0.5, squeezed**-0.5, squeezed])[None]
    sharp, wide = (
        acoustic_tensor(Material("mixture", {}, (SOFT, each)), F, X)[0, 2, 2]
        for each in (along, along.with_parameters(band=0.05))
    )
    assert wide == pytest.approx(sharp, rel=1e-9)
    assert sharp > 0.9 * (MU + 0.004 / 2)
