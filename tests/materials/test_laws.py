"""Every law: stress from energy, tangent from stress, derivatives by parameters, closed forms, FEBio."""

from __future__ import annotations

from pathlib import Path

import law_checks as checks
import numpy as np
import pytest
from law_checks import MATERIALS, UNIT, directions, program

from limbcli.errors import SolveError
from limbcli.feb.records import read_records
from limbcli.materials import LAWS, compile_material, ogden_type
from limbcli.materials.energy import program_energy, program_energy_change
from limbcli.materials.fiber import JUMP
from limbcli.materials.program import jumping
from limbcli.materials.stress import _evaluate, cauchy_stress, penalty_modulus, second_piola_kirchhoff
from limbcli.materials.tensors import VOIGT
from limbcli.model import Material

IN_PACKAGE = set(LAWS)  # other tests register laws of their own


@pytest.fixture
def states(rng: np.random.Generator) -> np.ndarray:
    """Random F with the fibre stretched (its law has a kink at no stretch)."""
    F = np.eye(3) + 0.15 * rng.standard_normal((12, 3, 3))
    a = np.array(UNIT)
    return F[np.linalg.norm(F @ a, axis=1) > 1.05]


@pytest.mark.parametrize("name", MATERIALS)
def test_stress_is_derivative_of_energy(name: str, states: np.ndarray, rng: np.random.Generator) -> None:
    checks.stress_is_derivative_of_energy(MATERIALS[name], states, rng)


@pytest.mark.parametrize("name", MATERIALS)
def test_tangent_is_derivative_of_stress(name: str, states: np.ndarray, rng: np.random.Generator) -> None:
    checks.tangent_is_derivative_of_stress(MATERIALS[name], states, rng)


@pytest.mark.parametrize("gap", [1e-1, 1e-2, 1e-3, 1e-5, 1e-8, 1e-12, 0.0])
@pytest.mark.parametrize("name", ["ogden", "ogden_uncoupled"])
def test_tangent_holds_where_stretches_meet(name: str, gap: float, rng: np.random.Generator) -> None:
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    F = (Q @ np.diag([1.1, 1.1 + gap, 0.9]) @ Q.T)[None]
    _, CC = second_piola_kirchhoff(MATERIALS[name], F)
    E = directions(rng, F)
    h = 1e-5
    dF = h * np.swapaxes(np.linalg.inv(F), 1, 2) @ E
    up, down = (second_piola_kirchhoff(MATERIALS[name], F + sign * dF)[0] for sign in (1, -1))
    expected = np.einsum("nijkl,nkl->nij", CC, E)
    np.testing.assert_allclose((up - down) / (2 * h), expected, atol=1e-7 * abs(expected).max())


@pytest.mark.parametrize("name", ["ogden", "mixture", "holmes_mow"])
def test_stress_does_not_see_a_rotation(name: str, states: np.ndarray, rng: np.random.Generator) -> None:
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    Q *= np.sign(np.linalg.det(Q))
    S, _ = second_piola_kirchhoff(MATERIALS[name], states)
    turned, _ = second_piola_kirchhoff(MATERIALS[name], Q @ states)
    np.testing.assert_allclose(turned, S, atol=1e-12 * abs(S).max() + 1e-15)


DERIVED = [
    ("ogden", "c1"), ("ogden", "m1"), ("ogden", "m2"), ("ogden", "kappa"),
    ("neo_hooke", "mu"), ("neo_hooke", "lambda"),
    ("mooney_rivlin", "c1"), ("mooney_rivlin", "c2"), ("mooney_rivlin", "kappa"),
    ("ogden_uncoupled", "c2"), ("ogden_uncoupled", "m1"),
    ("holmes_mow", "mu"), ("holmes_mow", "lambda"), ("holmes_mow", "beta"),
    ("fiber_exp_pow", "ksi"), ("fiber_exp_pow", "alpha"), ("fiber_exp_pow", "beta"),
    ("fiber_exp_pow", "mu"), ("fiber_exp_pow", "lam0"),
    ("active_contraction", "T0"),
]  # fmt: skip


def test_every_law_has_its_derivatives_checked() -> None:
    """A fit would take a wrong gradient otherwise."""
    assert {MATERIALS.get(name, SHEARED).law for name, _ in DERIVED} >= IN_PACKAGE, (
        "add a row for each parameter of the law to DERIVED above"
    )


@pytest.mark.parametrize(("name", "parameter"), DERIVED)
def test_parameter_derivative_of_stress(name: str, parameter: str, states: np.ndarray) -> None:
    material = {**MATERIALS, "sheared": SHEARED}[name]
    checks.parameter_derivative_of_stress(material, parameter, states)


@pytest.mark.parametrize("name", MATERIALS)
def test_changes_of_energy_and_tangent_are_their_differences(
    name: str, states: np.ndarray, rng: np.random.Generator
) -> None:
    # exponents of 2 are computed as such
    fixed = (2, 4) if name == "mooney_rivlin" else ()
    checks.changes_of_energy_and_tangent(MATERIALS[name], states, rng, fixed=fixed)


@pytest.mark.parametrize("alpha", [0.0, 0.4])
def test_energy_change_by_alpha_holds_at_none(alpha: float, states: np.ndarray) -> None:
    p = program(MATERIALS["fiber_exp_pow"].with_parameters(alpha=alpha), 1)
    dpar = np.zeros_like(p.par)
    dpar[0, 1] = 1.0
    up, down = (program_energy(p.ops, p.par + s * 1e-5 * dpar, states[:, None]) for s in (1, -1))
    exact = program_energy_change(p.ops, p.par, states[:, None], 0 * states[:, None], dpar)
    np.testing.assert_allclose(exact, (up - down) / 2e-5, atol=1e-8 * abs(exact).max())


def test_squares_need_no_principal_stretches(rng: np.random.Generator) -> None:
    """Exponents 2 and -2 are computed from C itself: the same as in principal axes, at 2 (1 + 1e-9)."""
    F = np.eye(3) + 0.3 * rng.standard_normal((50, 3, 3))
    F = F[np.linalg.det(F) > 0.1]
    numbers = {"c1": 0.003, "m1": 2.0, "c2": 0.001, "m2": -2.0, "c3": 0.002, "m3": -2.0, "kappa": 0.4}
    near = numbers | {"m1": 2.0 * (1 + 1e-9), "m2": -2.0 * (1 + 1e-9), "m3": -2.0 * (1 + 1e-9)}
    plain, general = (second_piola_kirchhoff(Material("ogden", each), F) for each in (numbers, near))
    for a, b in zip(plain, general, strict=True):
        sizes = abs(b).max(axis=tuple(range(1, b.ndim)), keepdims=True)
        assert (abs(a - b) / sizes).max() < 1e-6


def test_opposite_exponents_share_their_powers() -> None:
    """One after the other or apart: far out too, where a power less 1 would be lost by cancellation."""
    F = np.diag([0.55, 1.3, 1.2])[None]
    pair = {"c1": 0.003, "m1": 30.0, "c2": 0.002, "m2": -30.0, "kappa": 0.4}
    apart = {"c1": 0.003, "m1": 30.0, "c2": 1e-30, "m2": 1.0, "c3": 0.002, "m3": -30.0, "kappa": 0.4}
    for a, b in zip(
        *(second_piola_kirchhoff(Material("ogden", each), F) for each in (pair, apart)), strict=True
    ):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14 * abs(b).max())
    back = {"c1": 0.002, "m1": -30.0, "c2": 0.003, "m2": 30.0, "kappa": 0.4}
    a, b = (second_piola_kirchhoff(Material("ogden", each), F)[0] for each in (pair, back))
    np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14 * abs(b).max())


def test_uniaxial_ogden_agrees_with_its_closed_form() -> None:
    c, kappa, m = 0.005, 0.5, 8.0
    F = np.diag([1.2879749417, 1.2879749417, 0.6])[None]
    stress = cauchy_stress(ogden_type(c=c, f_kappa=kappa / c, m=m), F)[0]
    J = np.linalg.det(F[0])
    axial = (c / (2 * m) * (0.6**m - 0.6**-m)) / J + kappa * (J - 1)
    assert stress[2, 2] == pytest.approx(axial, rel=1e-12)
    assert abs(stress[0, 0]) < 1e-9  # the lateral stretch is the one that frees the sides


def test_penalty_modulus_along_an_axis_is_youngs() -> None:
    material = ogden_type(c=0.005, f_kappa=20.0, m=2.0)
    mu, lam = 0.0025, 0.1
    S, CC = np.zeros((1, 6)), np.zeros((1, 6, 6))
    p = program(material, 1)
    _evaluate(np.eye(3)[None], p.ops, p.par, S, CC, True)
    E = mu * (3 * lam + 2 * mu) / (lam + mu)
    assert penalty_modulus(CC, np.array([[0.0, 0.0, 1.0]]))[0] == pytest.approx(E, rel=1e-10)
    assert penalty_modulus(CC, np.array([[0.0, 0.6, 0.8]]))[0] < 0.7 * E


def test_penalty_modulus_falls_as_the_normal_leaves_the_axis() -> None:
    """By the parts that its docstring tells of nearly incompressible tissue."""
    C = np.zeros((6, 6))
    C[:3, :3] = 1000.0
    C += np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    angles = np.radians([0.0, 2.0, 45.0])
    E = penalty_modulus(np.stack([C] * 3), np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1))
    np.testing.assert_allclose(E / E[0], [1.0, 0.989, 0.308], atol=5e-4)


def test_every_law_is_tested() -> None:
    assert set(LAWS) <= set(MATERIALS), "add the law, under its name, to MATERIALS of law_checks.py"


@pytest.mark.parametrize(
    ("material", "word"),
    [
        (Material("biphasic", {}), "biphasic"),
        (Material("ogden", {"c1": 0.1, "m1": 2.0}), "kappa"),
        (Material("ogden", {"c1": 0.1, "m1": 2.0, "kappa": 1.0, "q": 1.0}), "'q'"),
        (Material("ogden", {"c1": 0.1, "m1": 0.0, "kappa": 1.0}), "exponent"),
        (Material("ogden", {"c1": 0.1, "m1": 2.0, "kappa": -1.0}), "not positive"),
        (Material("mixture", {}), "without solids"),
        (Material("fiber_exp_pow", {"ksi": 1.0}), "fiber"),
    ],
)
def test_a_wrong_material_is_refused_by_name(material: Material, word: str) -> None:
    with pytest.raises(SolveError, match=word):
        compile_material(material, "tissue")


@pytest.mark.parametrize("folder", ["cube-law-m8-fk100", "cube-law-m1.389-fk113", "cube-law-m8-fk1"])
def test_stress_agrees_with_febio_on_36_deformations(golden: Path, folder: str) -> None:
    from limbcli.feb.read import read_feb

    model = read_feb(golden / folder / "model.feb")
    table = read_records(golden / folder / "elements.csv").values[-1][:36]
    F = table[:, 7:16].reshape(-1, 3, 3)
    ours = cauchy_stress(model.materials["tissue"], F)
    theirs = table[:, 1:7]
    ours6 = ours[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    # F has 12 digits, and kappa J multiplies their round-off: 1e-11 * 0.5 MPa
    error = abs(ours6 - theirs).max(axis=1) / np.maximum(abs(theirs).max(axis=1), 1e-4)
    assert error.max() < 1e-6


# ---------------------------------------------------------------- fibres that begin to be stretched


def sheared(stretch: float) -> np.ndarray:
    """(1, 3, 3): sheared by 0.3, with the fibre's square length I4 = stretch."""
    F = np.eye(3) + 0.3 * np.outer(np.array([0.0, 0.0, 1.0]), UNIT)
    return np.array([F * np.sqrt(stretch) / np.linalg.norm(F @ np.array(UNIT))])


SHEARED = Material("fiber_exp_pow", {"ksi": 0.003, "alpha": 0.0, "beta": 2.0, "mu": 0.004, "fiber": UNIT})


def test_shear_term_of_a_fibre_comes_in_within_a_thin_band() -> None:
    """From 1 on, whole at 1 + JUMP, as FEBio has it there."""
    low, middle, high, after = (
        second_piola_kirchhoff(SHEARED, sheared(1 + k * JUMP))[0] for k in (-0.1, 0.5, 1.0, 1.1)
    )
    assert abs(low).max() == 0.0
    assert abs(high).max() > 1e-4
    np.testing.assert_allclose(middle, 0.5 * high, atol=2e-2 * abs(high).max())
    np.testing.assert_allclose(after, high, atol=1e-2 * abs(high).max())


def test_sloped_tangent_in_the_band_is_exact(rng: np.random.Generator) -> None:
    F = sheared(1 + 0.5 * JUMP)
    p = program(SHEARED, 1)
    assert jumping(p.ops, p.par).tolist() == [True]
    ops = p.ops.copy()
    ops[0, 2] = 1
    S, CC = np.zeros((1, 6)), np.zeros((1, 6, 6))
    _evaluate(F, ops, p.par, S, CC, True)
    assert abs(CC[0] - CC[0].T).max() > 0.1 * abs(CC).max()
    E = directions(rng, F)
    h = 1e-7
    dF = h * np.swapaxes(np.linalg.inv(F), 1, 2) @ E
    up, down = (second_piola_kirchhoff(SHEARED, F + sign * dF)[0] for sign in (1, -1))
    expected = np.einsum("nijkl,nkl->nij", CC[:, VOIGT][:, :, :, VOIGT], E)
    np.testing.assert_allclose((up - down) / (2 * h), expected, atol=1e-5 * abs(expected).max())


@pytest.mark.parametrize("name", ["ogden", "ogden six terms", "ogden_uncoupled"])
def test_derivative_by_exponents_and_moduli_together(
    name: str, states: np.ndarray, rng: np.random.Generator
) -> None:
    """Exponents share a program, so that the stretches of a point are computed once."""
    material = MATERIALS[name]
    rates = {each: value * rng.uniform(-1, 1) for each, value in material.parameters.items()}
    checks.derivative_of_stress(material, rates, states, h=1e-5)
    exponents = {each: rate for each, rate in rates.items() if each.startswith("m")}
    assert len(compile_material(material, "m").derivative(exponents, 1, lambda name: 1.0)) == 1


@pytest.mark.parametrize("name", ["band", "lam0", "beta", "mu"])
def test_parameter_derivative_of_stress_within_the_band(name: str) -> None:
    F = sheared(1 + 0.5 * JUMP)
    test_parameter_derivative_of_stress("sheared", name, F)


def test_a_fibres_direction_is_no_number() -> None:
    with pytest.raises(SolveError, match="direction"):
        compile_material(SHEARED, "m").derivative({"fiber": 1.0}, 1, lambda name: 1.0)


def test_fibre_that_engages_later_starts_from_nothing() -> None:
    """x = I4 - lam0^2, as in FEBio 4.11."""
    late = SHEARED.with_parameters(lam0=1.1, mu=0.0)
    S = second_piola_kirchhoff(late, sheared(1.21 + 0.01))[0][0]
    a = np.array(UNIT)
    assert a @ S @ a == pytest.approx(2 * 0.003 * 0.01)
