"""One formula for each law, the others its tests, for every law and state; forces by the envelope theorem."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.effects.frozen_deformation import SolvedDeformation, frozen_force
from limbcli.materials import LAWS, compile_material
from limbcli.materials.energy import program_energy
from limbcli.materials.laws import WRAPPERS
from limbcli.materials.ogden import ogden_type
from limbcli.model import Block, Curved, Domain, ElementMap, LimbModel, Material, Mesh
from limbcli.numbers import units
from limbcli.shear_waves import any_law, ogden
from limbcli.shear_waves.speed import block_speeds, element_speeds, material_speeds, shear_speed_m_per_s

N = 40
X = np.array([1.0, 0.0, 0.0])
STENCIL = {0: -205 / 72, 1: 8 / 5, 2: -1 / 5, 3: 8 / 315, 4: -1 / 560}
OGDEN = ogden_type(c=0.006, f_kappa=100.0, m=5.0)
NEO_HOOKE = Material("neo_hooke", {"mu": 0.004, "lambda": 0.16})
FIBRE = Material(
    "fiber_exp_pow",
    {"ksi": 0.003, "alpha": 0.4, "beta": 2.0, "mu": 0.004, "lam0": 1.0, "fiber": (0.6, 0.0, 0.8)},
)
ACTIVE = Material("active_contraction", {"T0": 0.002, "fiber": (0.6, 0.8, 0.0)})
SPREAD = np.linspace(0.002, 0.009, N)
MAPPED = {name: ElementMap(name, "tissue", SPREAD) for name in ("c1", "c2", "mu")}
EXAMPLES = {
    "Ogden": OGDEN,
    "Ogden, several terms": Material(
        "ogden",
        {"c1": 2e-3, "m1": 2.0, "c2": 2e-3, "m2": -2.0, "c3": 1e-3, "m3": 12.0, "c4": 1e-3, "m4": -12.0,
         "kappa": 0.5},
    ),
    "Ogden, a stiffness map": Material(
        "ogden", {"c1": MAPPED["c1"], "m1": 6.0, "c2": MAPPED["c2"], "m2": -6.0, "kappa": 0.6}
    ),
    "Ogden, a load curve": OGDEN.with_parameters(c1=Curved(0.003, "ramp")),
    "Ogden, uncoupled": Material("ogden_uncoupled", {"c1": 0.003, "m1": 4.0, "kappa": 0.3}),
    "Mooney-Rivlin": Material("mooney_rivlin", {"c1": 0.001, "c2": 0.0005, "kappa": 0.3}),
    "neo-Hooke": NEO_HOOKE,
    "neo-Hooke, a stiffness map": Material("neo_hooke", {"mu": MAPPED["mu"], "lambda": 0.3}),
    "Holmes-Mow": Material("holmes_mow", {"mu": 0.004, "lambda": 0.16, "beta": 0.35}),
    "fibres": Material("mixture", {}, (OGDEN, FIBRE)),
    "contraction": Material("mixture", {}, (OGDEN, ACTIVE)),
    "fibres that tense": Material("mixture", {}, (NEO_HOOKE, FIBRE, ACTIVE)),
    "viscoelastic, relaxed": Material("viscoelastic", {"g0": 1.0, "g1": 0.5, "t1": 10.0}, (OGDEN,)),
}  # fmt: skip


def _model(material: Material, n: int = N) -> LimbModel:
    points = np.vstack([np.zeros(3), np.eye(3)])
    mesh = Mesh(points, (Block("tissue", "tet4", np.array([[0, 1, 2, 3]] * n)),))
    return LimbModel(mesh, {"tissue": material}, (Domain("tissue", "tissue"),))


def _states(rng) -> dict[str, np.ndarray]:
    """At rest, equal stretches, squeezed, sheared, and anyhow; fibres clearly stretched or clearly slack."""
    same = np.zeros((N, 3, 3))
    squeezed = same + np.diag([1.15, 1.1, 0.8])
    sheared = same + np.eye(3)
    sheared[:, 0, 2] = np.linspace(0.1, 0.4, N)
    anyhow = np.eye(3) + 0.2 * rng.uniform(-1, 1, (20 * N, 3, 3))
    clear = np.ones(len(anyhow), dtype=bool)
    for a in (np.array([0.6, 0.0, 0.8]), np.array([0.6, 0.8, 0.0])):
        clear &= np.abs(np.linalg.norm(anyhow @ a, axis=1) - 1) > 0.03
    return {
        "rest": same + np.eye(3),
        "equal stretches": same + np.diag([0.9, 1.1, 0.9]),
        "squeezed": squeezed,
        "sheared": sheared,
        "anyhow": anyhow[clear & (np.linalg.det(anyhow) > 0.6)][:N],
    }


def by_energy(material: Material, F: np.ndarray, step: float = 3e-3) -> np.ndarray:
    """The third formula: rho v^2 is the second derivative of the energy along the wave, a x F'n.

    By its eighth-order difference, whose round-off is 1e-8 of the energy's own scale."""
    whole = compile_material(material, "tissue").program(N, lambda name: 1.0)
    wave = np.einsum("i,nj->nij", [0.0, 0.0, 1.0], np.einsum("nji,j->ni", F, X))
    modulus = sum(
        STENCIL[abs(k)] * program_energy(whole.ops, whole.par, (F + k * step * wave)[:, None])[:, 0]
        for k in range(-4, 5)
    ) / step**2  # fmt: skip
    density = units.tonne_per_mm3_from_kg_per_m3(1000.0)
    speed = np.sqrt(np.where(modulus > 0, modulus, np.nan) / density)
    return np.asarray(units.m_per_s_from_mm_per_s(speed))


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_formulas_agree_for_every_law_and_state(rng, name):
    material, cells = EXAMPLES[name], np.arange(N)
    for state, F in _states(rng).items():
        if "fibres" in name and state == "rest":
            continue  # they begin to work there: the tangent takes their stretched side, an energy both
        found = block_speeds(_model(material), "tissue", F, cells)
        assert np.isfinite(found).mean() > 0.5, state  # Holmes-Mow has no wave where it is pulled
        assert found == pytest.approx(by_energy(material, F), rel=1e-6, nan_ok=True), state
        Q = any_law.acoustic_tensor(material, F, X, cells=cells, n_cells=N, viscous=False)
        tangent = shear_speed_m_per_s(Q, mode="polarised")
        assert found == pytest.approx(tangent, rel=1e-7, nan_ok=True), state


def test_every_law_is_among_the_examples():
    """A law that is added gets its line above. Prestrain has its own test, of `any_law`."""
    laws = {part.law for each in EXAMPLES.values() for part in (each, *each.parts)}
    assert laws >= {*LAWS, *WRAPPERS} - {"prestrain"}, "add the law to EXAMPLES above"


def test_the_closed_form_rules_for_the_ogden_family_and_the_tangent_for_the_rest():
    for name, material in EXAMPLES.items():
        closed = ogden.terms_of(material, np.arange(N)) is not None
        assert closed == (name in {
            "Ogden", "Ogden, several terms", "Ogden, a stiffness map", "neo-Hooke"
        })  # fmt: skip


def test_speeds_of_elements_of_a_block_and_of_a_material_are_the_same_rule(rng):
    F, items = _states(rng)["squeezed"], np.arange(N)
    for material in EXAMPLES.values():
        whole = element_speeds(_model(material), F, items, density_kg_per_m3=1000.0)
        alone = material_speeds(material, F, items, n_cells=N)
        assert np.array_equal(whole, alone, equal_nan=True)
        polarised = material_speeds(material, F, items, n_cells=N, mode="polarised", viscous=False)
        block = block_speeds(_model(material), "tissue", F, items)
        assert np.array_equal(block, polarised, equal_nan=True)


def test_a_viscoelastic_law_answers_at_once_to_a_fit_and_relaxed_to_a_diagnosis(rng):
    F, law = _states(rng)["anyhow"], EXAMPLES["viscoelastic, relaxed"]
    at_once = material_speeds(law, F, np.arange(N), n_cells=N)
    assert at_once == pytest.approx(np.sqrt(1.5) * material_speeds(OGDEN, F, np.arange(N), n_cells=N))
    relaxed = block_speeds(_model(law), "tissue", F, np.arange(N))
    assert np.array_equal(relaxed, block_speeds(_model(OGDEN), "tissue", F, np.arange(N)))


def test_fibre_along_the_wave_adds_half_its_shear_modulus():
    law = ogden_type(c=0.006, f_kappa=100.0, m=2.0)
    fibre = {"ksi": 0.0, "alpha": 0.0, "beta": 2.0, "mu": 0.004, "lam0": 1.0, "fiber": (1.0, 0.0, 0.0)}
    mixed = Material("mixture", {}, (law, Material("fiber_exp_pow", fibre)))
    F = np.repeat(np.diag([1.0005, 1.0, 1.0])[None], 5, axis=0)  # fibres work in tension only
    speed = block_speeds(_model(mixed, 5), "tissue", F, np.arange(5))
    assert 1000 * speed[0] ** 2 * 1e-6 == pytest.approx(0.003 + 0.002, rel=0.01)


def test_frozen_force_of_a_uniform_squeeze_is_exact():
    """One cell squeezed without bulging of volume: F = dE/d(depth) by hand."""
    law = ogden_type(c=0.006, f_kappa=100.0, m=2.0)
    depth = np.linspace(0, 4, 17)
    stretch = 1 - depth / 10
    F = np.array([np.diag([s**-0.5, s**-0.5, s]) for s in stretch])[:, None, None]
    rest, volume = np.zeros((1, 1, 3)), np.array([[1000.0]])
    found = frozen_force(_model(law, 1), SolvedDeformation(depth, F, rest, volume))
    # W = c/8 (sum l^2 + l^-2 - 6), dW/ds = c/8 (2 s - 2 s^-2 - 2 s^-3 + 2), ds/ddepth = -1/10
    s = stretch
    exact = -100.0 * 0.006 / 8 * (2 * s - 2 * s**-2 - 2 * s**-3 + 2)
    assert found[2:-2] == pytest.approx(exact[2:-2], rel=1e-3)
