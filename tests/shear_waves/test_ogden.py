"""Wave speeds in deformed tissue, against differentiated energies and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.feb.read import read_feb
from limbcli.feb.records import read_records
from limbcli.model import Material
from limbcli.shear_waves.ogden import OgdenTerms, acoustic_tensor, principal_modulus
from limbcli.shear_waves.speed import wave_speed_m_per_s

X, Z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
# Eighth-order central second difference.
STENCIL = {0: -205 / 72, 1: 8 / 5, 2: -1 / 5, 3: 8 / 315, 4: -1 / 560}
LAWS = {
    "one pair": OgdenTerms.one_pair(c=0.006, m=6.0, kappa=0.6),
    "split weight": OgdenTerms.one_pair(c=0.006, m=8.0, kappa=3.0, weight=0.2),
    "two pairs": OgdenTerms(np.array([2e-3, 2e-3, 1e-3, 1e-3]), np.array([2.0, -2, 12, -12]), 0.5),
}


def energy(F, terms):
    """Written from the energy itself, sharing nothing with the module under test."""
    J = np.linalg.det(F)
    stretch = np.linalg.svd(F, compute_uv=False)
    terms_of = zip(terms.c, terms.m, strict=True)
    ogden = sum(c / m**2 * (np.sum(stretch**m) - 3 - m * np.log(J)) for c, m in terms_of)
    return ogden + terms.kappa / 2 * (J - 1) ** 2


def curvature(F, a, n, terms, h=4e-3):
    """Second derivative of the energy along the displacement gradient a (F'n)'."""
    wave = np.outer(a, F.T @ n)
    values = {k: energy(F + k * h * wave, terms) for k in range(-4, 5)}
    return sum(STENCIL[abs(k)] * values[k] for k in values) / h**2


def random_gradients(rng, n=12, size=0.35):
    found = np.eye(3) + size * rng.uniform(-1, 1, (4 * n, 3, 3))
    return found[np.linalg.det(found) > 0.4][:n]


@pytest.mark.parametrize("law", LAWS)
def test_acoustic_tensor_is_curvature_of_energy_at_random_deformations(rng, law):
    terms = LAWS[law]
    for F in random_gradients(rng):
        n = rng.standard_normal(3)
        n /= np.linalg.norm(n)
        Q = acoustic_tensor(F[None], n, terms)[0]
        expected = np.array([curvature(F, e, n, terms) for e in np.eye(3)])
        a = rng.standard_normal(3)
        assert np.diag(Q) == pytest.approx(expected, rel=1e-7)
        assert a @ Q @ a == pytest.approx(curvature(F, a, n, terms), rel=1e-7)


def test_shear_wave_speed_matches_energy_though_nearly_incompressible(rng):
    terms = OgdenTerms.one_pair(c=0.006, m=5.0, kappa=500 * 0.006)
    F = random_gradients(rng)
    speed = wave_speed_m_per_s(F, terms, mode="polarised")
    for each, v in zip(F, speed, strict=True):
        assert 1e-9 * (1e3 * v) ** 2 == pytest.approx(curvature(each, Z, X, terms), rel=1e-7)


def test_kappa_drops_out_of_the_speed(rng):
    F = random_gradients(rng)
    for mode in ("polarised", "eigenmode"):
        soft, stiff = (
            wave_speed_m_per_s(F, OgdenTerms.one_pair(c=0.006, m=5.0, kappa=kappa), mode=mode)
            for kappa in (0.0, 6.0)
        )
        assert np.array_equal(soft, stiff)


def test_eigenmode_is_the_eigenvalue_of_the_whole_tensor_up_to_mu_over_kappa(rng):
    F = random_gradients(rng, size=0.2)
    terms = OgdenTerms.one_pair(c=0.006, m=5.0, kappa=60.0)
    values, vectors = np.linalg.eigh(acoustic_tensor(F, X, terms))
    shear = np.argmax(np.abs(vectors[:, 2, :2]), axis=1)
    whole = np.sqrt(np.take_along_axis(values, shear[:, None], 1)[:, 0] / 1e-9) / 1e3
    assert wave_speed_m_per_s(F, terms) == pytest.approx(whole, rel=1e-3)


def test_undeformed_speed_gives_back_the_ground_shear_modulus():
    for terms in LAWS.values():
        mu = terms.c.sum() / 2
        speed = wave_speed_m_per_s(np.eye(3)[None], terms)
        assert speed[0] == pytest.approx(np.sqrt(mu / 1e-9) / 1e3, rel=1e-12)


@pytest.mark.parametrize("m", [2.0, 6.0, 11.0])
def test_aligned_stretches_follow_the_closed_form(m):
    x_x, x_z = 0.12, -0.31
    F = np.diag(np.exp([x_x, -x_x - x_z, x_z]))[None]
    c = 0.006
    expected = (c / m) * np.exp(x_x - x_z) * np.cosh(m * (x_x + x_z) / 2)
    expected *= np.sinh(m * (x_x - x_z) / 2) / np.sinh(x_x - x_z)
    speed = wave_speed_m_per_s(F, OgdenTerms.one_pair(c=c, m=m))
    assert 1e-9 * (1e3 * speed[0]) ** 2 == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("m", [2.0, 9.0])
@pytest.mark.parametrize("c", [0.002, 0.02])
def test_first_order_slope_is_kinematics_alone(c, m):
    """rho0 v^2 / mu = 1 + (x_x - x_z): the same for every c and m (split weight 1/2)."""
    for x_x, x_z in ((1e-4, -3e-4), (0.0, -2e-4), (2e-4, 1e-4)):
        F = np.diag(np.exp([x_x, -x_x - x_z, x_z]))[None]
        v2 = (1e3 * wave_speed_m_per_s(F, OgdenTerms.one_pair(c=c, m=m))[0]) ** 2 * 1e-9
        assert v2 / (c / 2) - 1 == pytest.approx(x_x - x_z, abs=2e-6)


@pytest.mark.parametrize("weight", [0.5, 0.1])
def test_second_order_expansion_and_the_split_weight(weight):
    """... + (x_x - x_z)^2/3 + (m^2/6)(x_x^2 + x_x x_z + x_z^2); a split adds -(m/2)(2q - 1) x_y first."""
    m, x_x, x_z = 7.0, 2e-3, -5e-3
    x_y = -x_x - x_z
    F = np.diag(np.exp([x_x, x_y, x_z]))[None]
    v2 = (1e3 * wave_speed_m_per_s(F, OgdenTerms.one_pair(c=0.006, m=m, weight=weight))[0]) ** 2 * 1e-9
    first = x_x - x_z - m / 2 * (2 * weight - 1) * x_y
    if weight == 0.5:
        second = (x_x - x_z) ** 2 / 3 + m**2 / 6 * (x_x**2 + x_x * x_z + x_z**2)
        assert v2 / 0.003 - 1 == pytest.approx(first + second, abs=3e-6)
        assert abs(second) > 1e-4
    else:
        assert v2 / 0.003 - 1 == pytest.approx(first, abs=4e-4)


@pytest.mark.parametrize("folder", ["cube-law-m8-fk100", "cube-law-m1.389-fk113", "cube-law-m8-fk1"])
def test_formula_agrees_with_febio_on_its_logged_deformations(golden, folder):
    """FEBio's stress and tangent (its columns read by place, their names being wrong in 4.11)."""
    terms = OgdenTerms.of(read_feb(golden / folder / "model.feb").materials["tissue"])
    logged = read_records(golden / folder / "elements.csv").values[-1][:36]
    tangent = read_records(golden / folder / "tangent.csv").values[-1][:36, :18].reshape(-1, 3, 6)
    J, stress, F = logged[:, 0], logged[:, 1:7], logged[:, 7:16].reshape(-1, 3, 3)
    along_x, along_z = (acoustic_tensor(F, n, terms) / J[:, None, None] for n in (X, Z))
    xx, zz, xy, yz, xz = 0, 2, 3, 4, 5
    scale = np.abs(tangent).max(axis=(1, 2))
    pairs = [
        (along_x[:, 0, 0], tangent[:, 0, xx] + stress[:, 0]),
        (along_x[:, 0, 1], tangent[:, 0, xy]),
        (along_x[:, 0, 2], tangent[:, 0, xz]),
        (along_z[:, 2, 2], tangent[:, 2, zz] + stress[:, 2]),
        (along_z[:, 1, 2], tangent[:, 2, yz]),
    ]
    for ours, theirs in pairs:
        assert (np.abs(ours - theirs) / scale).max() < 1e-6
    # c_xzxz is not in the log; both waves that it carries must give the same one with FEBio's stress.
    mine, other = along_x[:, 2, 2] - stress[:, 0], along_z[:, 0, 0] - stress[:, 2]
    assert (np.abs(mine - other) / np.abs(terms.c).sum()).max() < 1e-4
    assert np.abs(mine).min() > 0


def test_nearly_equal_stretches_are_continuous():
    terms = OgdenTerms.one_pair(c=0.006, m=6.0)
    gaps = (0.0, 1e-7, 2e-6, 4.9e-6, 5.1e-6, 2e-5)
    speeds = [wave_speed_m_per_s(np.diag([1.2, 0.8, 1.2 + gap])[None], terms)[0] for gap in gaps]
    assert np.ptp(speeds) < 1e-4 * speeds[0]
    assert abs(speeds[4] - speeds[3]) < 1e-6 * speeds[0]


def test_rotation_of_tissue_and_wave_together_changes_nothing(rng):
    terms = LAWS["one pair"]
    F = random_gradients(rng)
    R, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    R *= np.sign(np.linalg.det(R))
    turned = wave_speed_m_per_s(R @ F, terms, direction=R @ X, polarisation=R @ Z)
    assert turned == pytest.approx(wave_speed_m_per_s(F, terms), rel=1e-9)


def test_inverted_element_is_an_error():
    with pytest.raises(MeasurementError, match="det F"):
        wave_speed_m_per_s(np.diag([1.0, 1.0, -1.0])[None], LAWS["one pair"])


def test_terms_come_from_the_material_and_other_laws_are_refused():
    ogden = Material("ogden", {"c1": 0.003, "m1": 6.0, "c2": 0.003, "m2": -6.0, "kappa": 0.5})
    terms = OgdenTerms.of(ogden)
    assert terms.c.tolist() == [0.003, 0.003]
    assert terms.m.tolist() == [6.0, -6.0]
    assert terms.kappa == 0.5
    with pytest.raises(MeasurementError, match="holmes_mow"):
        OgdenTerms.of(Material("holmes_mow", {"mu": 1.0}))


def test_stiffness_may_differ_from_point_to_point():
    c = np.array([[0.003, 0.003], [0.006, 0.006]])
    speed = wave_speed_m_per_s(np.stack([np.eye(3)] * 2), OgdenTerms(c, np.array([6.0, -6.0])))
    assert speed == pytest.approx(np.sqrt([3.0, 6.0]))


@pytest.mark.parametrize("law", LAWS)
def test_modulus_between_principal_axes_is_that_of_the_acoustic_tensor(law, rng):
    """Along x, moving along z, of stretches that are far apart, nearly equal and equal."""
    stretch = rng.uniform(0.6, 1.6, (6, 3))
    stretch[4, 2], stretch[5, 2] = stretch[4, 0] * (1 + 1e-6), stretch[5, 0]
    Q = acoustic_tensor(np.eye(3) * stretch[:, None, :], X, LAWS[law], volumetric=False)
    found = principal_modulus(LAWS[law], stretch[:, 0], stretch[:, 2])
    np.testing.assert_allclose(found, Q[:, 2, 2], rtol=1e-6)
