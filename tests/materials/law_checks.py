"""What must hold of every law, and an example of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from limbcli.materials import compile_material, ogden_type, simd, simd_laws
from limbcli.materials.dispatch import workspace
from limbcli.materials.energy import program_energy, program_energy_change
from limbcli.materials.fiber import JUMP
from limbcli.materials.simd import LANES
from limbcli.materials.stress import _evaluate, second_piola_kirchhoff, tangent_change
from limbcli.model import Material

UNIT = (0.0, 0.8, 0.6)
MATERIALS = {
    "ogden": ogden_type(c=0.005, f_kappa=20.0, m=3.2),
    "ogden six terms": Material(
        "ogden",
        {f"c{k}": 0.001 * k for k in range(1, 7)}
        | {f"m{k}": (-1.0) ** k * (0.7 + k) for k in range(1, 7)}
        | {"kappa": 0.05},
    ),
    "neo_hooke": Material("neo_hooke", {"mu": 0.002, "lambda": 0.03}),
    "mooney_rivlin": Material("mooney_rivlin", {"c1": 0.002, "c2": 0.001, "kappa": 0.1}),
    "ogden_uncoupled": Material(
        "ogden_uncoupled", {"c1": 0.002, "m1": 3.0, "c2": 0.001, "m2": -4.0, "kappa": 0.1}
    ),
    "holmes_mow": Material("holmes_mow", {"mu": 0.002, "lambda": 0.01, "beta": 0.6}),
    "fiber_exp_pow": Material(
        "fiber_exp_pow", {"ksi": 0.003, "alpha": 0.4, "beta": 2.5, "mu": 0.004, "fiber": UNIT}
    ),
    "active_contraction": Material("active_contraction", {"T0": 0.003, "fiber": UNIT}),
    "mixture": Material(
        "mixture",
        {},
        (
            ogden_type(c=0.005, f_kappa=20.0, m=2.0),
            Material("fiber_exp_pow", {"ksi": 0.003, "alpha": 0.0, "beta": 2.0, "mu": 0.004, "fiber": UNIT}),
        ),
    ),
}


def directions(rng: np.random.Generator, F: np.ndarray) -> np.ndarray:
    E = rng.standard_normal(F.shape)
    return E + np.swapaxes(E, 1, 2)


def program(material: Material, n: int):
    return compile_material(material, "m").program(n, lambda name: 1.0)


def evaluated(
    material: Material, F: np.ndarray, shift: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """J (16,), S (16, 6), CC (16, 6, 6) of the vectors."""
    program = compile_material(material, "m").program(LANES, lambda name: 1.0)
    w, place, six, square = simd.simd_workspace()
    rows = w.reshape(-1, LANES)
    rows[simd.F : simd.F + 9] = F.reshape(LANES, 9).T
    if shift is not None:
        rows[simd.SHIFT] = shift
    numbers = np.arange(LANES) if len(program.par) > 1 else np.zeros(LANES, dtype=np.int64)
    simd_laws.measure(w)
    simd_laws.add_laws(w, program.ops, program.par, numbers, True, place, six, square, workspace())
    simd_laws.finish(w, True)
    CC = rows[simd.CC + simd.UPPER]
    return (
        rows[simd.J].copy(),
        rows[simd.S : simd.S + 6].T.copy(),
        CC.transpose(2, 0, 1).copy(),
    )


def one_by_one(material: Material, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    program = compile_material(material, "m").program(LANES, lambda name: 1.0)
    S, CC = np.zeros((LANES, 6)), np.zeros((LANES, 6, 6))
    _evaluate(F, program.ops, program.par, S, CC, True)
    return S, CC


def stress_is_derivative_of_energy(material: Material, states: np.ndarray, rng: np.random.Generator) -> None:
    S, _ = second_piola_kirchhoff(material, states)
    p = program(material, len(states))
    dF = rng.standard_normal(states.shape)
    h = 1e-6
    up, down = (program_energy(p.ops, p.par, (states + sign * h * dF)[:, None])[:, 0] for sign in (1, -1))
    expected = np.einsum("nij,nij->n", states @ S, dF)
    # contraction's energy T0/2 (I4 - 1) and the others': differences of 1e-6 leave about 1e-8 relative
    np.testing.assert_allclose((up - down) / (2 * h), expected, rtol=1e-6, atol=1e-9)


def tangent_is_derivative_of_stress(material: Material, states: np.ndarray, rng: np.random.Generator) -> None:
    _, CC = second_piola_kirchhoff(material, states)
    E = directions(rng, states)
    h = 1e-6
    dF = h * np.swapaxes(np.linalg.inv(states), 1, 2) @ E
    up, down = (second_piola_kirchhoff(material, states + sign * dF)[0] for sign in (1, -1))
    expected = np.einsum("nijkl,nkl->nij", CC, E)
    np.testing.assert_allclose((up - down) / (2 * h), expected, atol=1e-6 * max(abs(expected).max(), 1e-6))


def parameter_derivative_of_stress(material: Material, parameter: str, states: np.ndarray) -> None:
    value = {"lam0": 1.0, "band": JUMP, **material.parameters}[parameter]
    derivative_of_stress(material, {parameter: 1.0}, states, h=1e-5 * max(abs(value), 1e-3))


def derivative_of_stress(
    material: Material, rates: Mapping[str, float], states: np.ndarray, *, h: float
) -> None:
    """Where several parameters change together, each at its rate."""
    values = {"lam0": 1.0, "band": JUMP, **material.parameters}
    up, down = (
        second_piola_kirchhoff(
            material.with_parameters(**{name: values[name] + s * h * rate for name, rate in rates.items()}),
            states,
        )[0]
        for s in (1, -1)
    )
    total = np.zeros((len(states), 6))
    for each in compile_material(material, "m").derivative(rates, len(states), lambda name: 1.0):
        S, CC = np.zeros((len(states), 6)), np.zeros((len(states), 6, 6))
        _evaluate(states, each.ops, each.par, S, CC, False)
        total += S if each.factor is None else S * each.factor[:, None]
    numeric = ((up - down) / (2 * h))[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    np.testing.assert_allclose(total, numeric, atol=1e-6 * abs(numeric).max())


def changes_of_energy_and_tangent(
    material: Material, states: np.ndarray, rng: np.random.Generator, *, fixed: Sequence[int] = ()
) -> None:
    """Along a random change of F and of the law's numbers together, but for those that are `fixed`."""
    p = program(material, 1)
    dF, par = rng.standard_normal(states.shape), p.par
    dpar = par * rng.uniform(-1, 1, par.shape)
    dpar[:, list(fixed)] = 0.0
    h = 2e-5
    ends = [(states + s * h * dF, par + s * h * dpar) for s in (1, -1)]
    up, down = (program_energy(p.ops, q, F[:, None]) for F, q in ends)
    energy = program_energy_change(p.ops, par, states[:, None], dF[:, None], dpar)
    np.testing.assert_allclose(energy, (up - down) / (2 * h), rtol=1e-6, atol=1e-6 * abs(energy).max())
    tangents = []
    for F, q in ends:
        S, CC = np.zeros((len(F), 6)), np.zeros((len(F), 6, 6))
        _evaluate(F, p.ops, q, S, CC, True)
        tangents.append(CC)
    change = tangent_change(p.ops, par, states, dF, dpar)
    numeric = (tangents[0] - tangents[1]) / (2 * h)
    np.testing.assert_allclose(change, numeric, atol=1e-6 * max(abs(numeric).max(), 1e-12))


def vectors_are_single_points(material: Material, size: float, rng: np.random.Generator) -> None:
    """What a simulation computes, sixteen points at once, against `second_piola` point after point."""
    F = np.eye(3) + size * rng.standard_normal((LANES, 3, 3))
    F[np.linalg.det(F) < 0.2] = np.eye(3)
    J, S, CC = evaluated(material, F)
    exact_S, exact_CC = one_by_one(material, F)
    np.testing.assert_allclose(J, np.linalg.det(F), rtol=1e-13)
    np.testing.assert_allclose(CC, exact_CC, rtol=0, atol=2e-12 * abs(exact_CC).max())
    # at rest the stress is a difference of numbers as large as the stiffness
    np.testing.assert_allclose(S, exact_S, rtol=0, atol=1e-12 * abs(exact_S).max() + 1e-15 * abs(CC).max())
