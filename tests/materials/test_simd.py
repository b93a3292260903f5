"""Sixteen points at once, against one point after the other."""

from __future__ import annotations

import law_checks as checks
import numpy as np
import pytest
from law_checks import evaluated, one_by_one

from limbcli.materials import LAWS, ogden_type
from limbcli.materials.simd import LANES
from limbcli.model import ElementMap, Material

FIBRES = checks.MATERIALS["fiber_exp_pow"]
MATERIALS = {
    "squares": ogden_type(c=0.005, f_kappa=20.0, m=2.0),
    "any exponent": ogden_type(c=0.005, f_kappa=20.0, m=7.3),
    "near one": ogden_type(c=0.005, f_kappa=1000.0, m=1.0001),
    "steep": ogden_type(c=0.005, f_kappa=20.0, m=60.0),
    "six terms": Material(
        "ogden",
        {f"c{k}": 0.001 * k for k in range(1, 7)}
        | {f"m{k}": (-1.0) ** k * (0.7 + k) for k in range(1, 7)}
        | {"kappa": 0.05},
    ),
    "another law": Material("holmes_mow", {"mu": 0.002, "lambda": 0.01, "beta": 0.6}),
    "mixture": Material("mixture", {}, (ogden_type(c=0.005, f_kappa=20.0, m=3.0), FIBRES)),
    "a map": Material(
        "ogden",
        {
            "c1": ElementMap("map", "tissue", np.linspace(0.001, 0.004, LANES)),
            "m1": 4.0,
            "c2": ElementMap("map", "tissue", np.linspace(0.004, 0.001, LANES)),
            "m2": -4.0,
            "kappa": ElementMap("map", "tissue", np.linspace(0.1, 1.0, LANES)),
        },
    ),
}


@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("size", [1e-9, 1e-4, 0.2])
def test_stress_and_tangent_are_those_of_single_points(
    name: str, size: float, rng: np.random.Generator
) -> None:
    checks.vectors_are_single_points(MATERIALS[name], size, rng)


@pytest.mark.parametrize("name", checks.MATERIALS)
def test_every_law_is_the_same_in_both_at_hundreds_of_states(name: str, rng: np.random.Generator) -> None:
    """Up to strains at which half of the random gradients turn inside out; these are left out."""
    for size in np.repeat([0.02, 0.1, 0.3, 0.5], 10):
        checks.vectors_are_single_points(checks.MATERIALS[name], size, rng)


def test_every_law_has_an_example() -> None:
    assert {*LAWS, "mixture"} <= {each.law for each in checks.MATERIALS.values()}


@pytest.mark.parametrize("stretches", [(1.2, 1.2, 0.7), (1.2, 1.2 * (1 + 1e-9), 0.7), (0.9, 0.9, 0.9)])
def test_stretches_that_meet(stretches: tuple[float, float, float]) -> None:
    F = np.repeat(np.diag(stretches)[None], LANES, axis=0)
    _, S, CC = evaluated(MATERIALS["any exponent"], F)
    exact_S, exact_CC = one_by_one(MATERIALS["any exponent"], F)
    np.testing.assert_allclose(S, exact_S, rtol=0, atol=1e-12 * abs(exact_S).max())
    np.testing.assert_allclose(CC, exact_CC, rtol=0, atol=1e-9 * abs(exact_CC).max())


@pytest.mark.parametrize("name", ["squares", "any exponent"])
def test_a_pressure_more_is_a_bulk_stiffness_at_another_volume(name: str, rng: np.random.Generator) -> None:
    """shift = kappa (J' - J) gives the stress of a law whose pressure is kappa (J' - 1)."""
    F = np.eye(3) + 0.1 * rng.standard_normal((LANES, 3, 3))
    J = np.linalg.det(F)
    material = MATERIALS[name]
    other = J * rng.uniform(0.9, 1.1, LANES)
    kappa = material.parameters["kappa"]
    S = evaluated(material, F, kappa * (other - J))[1]
    inverse = np.linalg.inv(np.swapaxes(F, 1, 2) @ F)
    more = (kappa * (other - J) * J)[:, None] * inverse[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    np.testing.assert_allclose(S, one_by_one(material, F)[0] + more, rtol=0, atol=1e-12 * abs(S).max())


@pytest.mark.parametrize("name", ["squares", "any exponent", "mixture"])
def test_a_point_turned_inside_out_harms_no_other(name: str, rng: np.random.Generator) -> None:
    F = np.eye(3) + 0.1 * rng.standard_normal((LANES, 3, 3))
    _, sound, _ = evaluated(MATERIALS[name], F)
    F[3] = np.diag([1.0, -1.0, 1.0])
    F[5] = 0.0
    J, S, CC = evaluated(MATERIALS[name], F)
    assert J[3] == -1.0
    assert J[5] == 0.0
    assert np.isfinite(S).all()
    assert np.isfinite(CC).all()
    others = np.setdiff1d(np.arange(LANES), [3, 5])
    assert np.array_equal(S[others], sound[others])
