"""A law that no file of the package knows: one file, and its name in LAWS, is all that it takes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import law_checks as checks
import numpy as np
import pytest
from demiray import LAW

from limbcli.errors import CaseError, SolveError
from limbcli.feb.read import read_feb
from limbcli.feb.write import write_feb
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.materials import LAWS, compile_material, ogden_type, register
from limbcli.materials.stress import second_piola_kirchhoff
from limbcli.model import LimbModel, Material
from limbcli.solvers.session import ReferenceSession
from limbcli.stages.machine.self_test import HEIGHT, SIDE, indentation

MU, LAMBDA, B = 0.004, 0.04, 0.8
MATERIAL = Material("demiray", {"mu": MU, "lambda": LAMBDA, "b": B})
MIXED = Material("mixture", {}, (ogden_type(c=0.005, f_kappa=20.0, m=3.0), MATERIAL))


@pytest.fixture(autouse=True)
def known() -> Iterator[None]:
    register(LAW)
    yield
    LAWS.pop(LAW.name)


@pytest.fixture
def states(rng: np.random.Generator) -> np.ndarray:
    return np.eye(3) + 0.15 * rng.standard_normal((12, 3, 3))


@pytest.mark.parametrize("material", [MATERIAL, MIXED], ids=["alone", "in a mixture"])
def test_energy_stress_and_tangent_hang_together(
    material: Material, states: np.ndarray, rng: np.random.Generator
) -> None:
    """As for every law of the package, by the same checks."""
    checks.stress_is_derivative_of_energy(material, states, rng)
    checks.tangent_is_derivative_of_stress(material, states, rng)
    checks.changes_of_energy_and_tangent(material, states, rng)


@pytest.mark.parametrize("parameter", ["mu", "lambda", "b"])
def test_stress_is_differentiated_by_its_parameters(parameter: str, states: np.ndarray) -> None:
    checks.parameter_derivative_of_stress(MATERIAL, parameter, states)


@pytest.mark.slow
@pytest.mark.parametrize("material", [MATERIAL, MIXED], ids=["alone", "in a mixture"])
def test_the_loops_of_a_simulation_take_it_point_by_point(
    material: Material, rng: np.random.Generator
) -> None:
    for size in (1e-6, 0.05, 0.2):
        checks.vectors_are_single_points(material, size, rng)


def pressed() -> LimbModel:
    return indentation().with_material("tissue", MATERIAL)


def test_a_model_file_with_it_reads_back(tmp_path: Path) -> None:
    path = write_feb(pressed(), tmp_path / "model.feb")
    assert 'type="demiray plug-in"' in path.read_text(encoding="utf-8")
    found = read_feb(path).materials["tissue"]
    assert (found.law, dict(found.parameters)) == ("demiray", dict(MATERIAL.parameters))


def nominal_stress(stretch: float) -> float:
    """P = dW/dl in uniaxial strain, by hand: I1 = 2 + l^2, J = l."""
    return MU * (stretch * np.exp(B * (stretch**2 - 1)) - 1 / stretch) + LAMBDA * np.log(stretch) / stretch


def test_a_block_pressed_flat_bears_the_force_of_the_closed_form() -> None:
    model = pressed()
    last = Analysis(model, Settings(tolerance=1e-10, threads=1)).run()[-1]
    top = model.mesh.node_sets["top"]
    stretch = 1 + last.state.u[top, 2].mean() / HEIGHT
    assert stretch < 0.7
    expected = SIDE**2 * nominal_stress(stretch)
    assert abs(last.forces.bodies[0, 2]) == pytest.approx(-expected, rel=1e-7)


def test_a_fit_gets_the_derivative_of_the_force() -> None:
    def force(b: float) -> float:
        model = indentation().with_material("tissue", MATERIAL.with_parameters(b=b))
        return float(Analysis(model, Settings(tolerance=1e-10, threads=1)).run()[-1].forces.bodies[0, 2])

    with ReferenceSession(pressed(), tolerance=1e-10) as session:
        solved = session.solve(wrt=[("tissue", "b")])
    exact = abs(solved.force_gradient[("tissue", "b")][-1])
    assert not solved.differenced
    assert exact == pytest.approx(abs(force(B + 1e-4) - force(B - 1e-4)) / 2e-4, rel=1e-5)


def test_a_name_is_given_once() -> None:
    with pytest.raises(SolveError, match="'demiray' cannot be added"):
        register(LAW)
    with pytest.raises(SolveError, match="there is 'demiray'"):
        register(replace(LAW, name="another"))


def test_what_is_not_registered_is_refused_by_name() -> None:
    stranger = Material("stranger", {})
    with pytest.raises(SolveError, match="stranger"):
        compile_material(stranger, "tissue")
    with pytest.raises(CaseError, match="stranger"):
        write_feb(indentation().with_material("tissue", stranger), Path("never.feb"))


def test_its_check_of_parameters_holds() -> None:
    with pytest.raises(SolveError, match=r"b = -1\.0 is not positive"):
        second_piola_kirchhoff(MATERIAL.with_parameters(b=-1.0), np.eye(3)[None])
