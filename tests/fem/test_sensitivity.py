"""Derivatives of the probe's force and of displacements against central differences (1e-5)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from small_models import punch

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.derivatives.parameters import LawParameter, Parameter, Prestrain
from limbcli.fem.derivatives.sensitivity import sensitivities
from limbcli.fem.equilibrium.settings import Settings
from limbcli.materials import ogden_type
from limbcli.model import Curved, ElementMap, LimbModel, Material, Support
from limbcli.model.bodies import Drive
from limbcli.solvers.session import ReferenceSession

TIGHT = Settings(tolerance=1e-12, threads=1)
FIBRES = Material(
    "mixture",
    {},
    (
        ogden_type(c=0.0052, f_kappa=7.3, m=3.1),
        Material("fiber_exp_pow", {"ksi": 0.002, "alpha": 0.3, "beta": 2.4, "fiber": (0.0, 1.0, 0.0)}),
    ),
)
PLAIN = ogden_type(c=0.0052, f_kappa=7.3, m=3.1)


def response(model: LimbModel, parameter: Parameter | None = None):
    """Force on the probe and displacements at 0.6 mm, and their derivative."""
    analysis = Analysis(model, TIGHT)
    last = analysis.run()[-1]
    derivative = None
    if parameter is not None:
        (derivative,) = sensitivities(analysis.newton, last.state, last.forces, [parameter])
    analysis.close()
    return last.forces.bodies[0], last.state.u, derivative


def check(
    model: LimbModel, parameter: Parameter, change: Callable[[LimbModel, float], LimbModel], h: float
) -> None:
    _, _, exact = response(model, parameter)
    (fp, up, _), (fm, um, _) = response(change(model, h)), response(change(model, -h))
    numeric = (fp - fm) / (2 * h)
    np.testing.assert_allclose(exact.bodies[0], numeric, atol=1e-5 * abs(numeric).max())
    tissue = ~np.isin(np.arange(len(up)), model.mesh.block("probe").cells)
    difference = ((up - um) / (2 * h))[tissue]
    np.testing.assert_allclose(exact.displacement[tissue], difference, atol=1e-5 * abs(difference).max())


def small(kind: str = "tet4", material: Material = PLAIN) -> LimbModel:
    return punch(kind, (3, 2, 2), depth=0.6, levels=1, material=material)


@pytest.mark.parametrize("name", ["c1", "m1", "c2", "m2", "kappa"])
def test_force_by_law_parameter(name: str) -> None:
    """The contact penalty follows the law, and is differentiated with it."""
    value = PLAIN.parameters[name]

    def change(model: LimbModel, h: float) -> LimbModel:
        return model.with_material("tissue", PLAIN.with_parameters(**{name: value + h}))

    check(small(), LawParameter("tissue", {name: 1.0}), change, 1e-4 * abs(value))


@pytest.mark.parametrize(("part", "name"), [(1, "ksi"), (1, "alpha"), (1, "beta"), (0, "c1")])
def test_force_by_parameter_of_a_mixture(part: int, name: str) -> None:
    value = FIBRES.parts[part].parameters[name]

    def change(model: LimbModel, h: float) -> LimbModel:
        parts = list(FIBRES.parts)
        parts[part] = parts[part].with_parameters(**{name: value + h})
        return model.with_material("tissue", replace(FIBRES, parts=tuple(parts)))

    check(small("tet4", FIBRES), LawParameter("tissue", {name: 1.0}), change, 1e-4 * abs(value))


def test_force_by_map_coefficient(rng: np.random.Generator) -> None:
    n = len(small().mesh.block("tissue").cells)
    base, weights = 0.0026 * (1 + 0.3 * rng.uniform(size=n)), rng.uniform(size=n)

    def mapped(theta: float) -> LimbModel:
        values = ElementMap("c1", "tissue", base + theta * weights)
        return small("tet4", PLAIN.with_parameters(c1=values))

    check(mapped(0.0), LawParameter("tissue", {"c1": 1.0}, weights=weights), lambda _, h: mapped(h), 1e-6)


@pytest.mark.parametrize("what", ["ramp", "ramp on a curve", "F0"])
def test_force_by_prestrain(what: str, rng: np.random.Generator) -> None:
    F0 = np.diag([1.04, 1.02, 0.96]) + 0.01 * rng.standard_normal((3, 3))
    direction = rng.standard_normal((3, 3)) if what == "F0" else None

    def law(h: float) -> Material:
        moved = F0 if direction is None else F0 + h * direction
        ramp = 0.7 if direction is not None else 0.7 + h
        value = Curved(ramp, "ramp") if what == "ramp on a curve" else ramp
        return Material("prestrain", {"F0": tuple(moved.ravel().tolist()), "ramp": value}, (PLAIN,))

    def change(model: LimbModel, h: float) -> LimbModel:
        return model.with_material("tissue", law(h))

    check(small(material=law(0.0)), Prestrain("tissue", direction), change, 1e-4)


def test_force_by_parameter_with_tet10() -> None:
    value = PLAIN.parameters["m1"]

    def change(model: LimbModel, h: float) -> LimbModel:
        return model.with_material("tissue", PLAIN.with_parameters(m1=value + h))

    check(small("tet10"), LawParameter("tissue", {"m1": 1.0}), change, 1e-3)


def test_a_session_knows_the_ramp_of_a_prestrain() -> None:
    taut = tuple(np.diag([1.04, 1.02, 0.96]).ravel().tolist())
    model = small(material=Material("prestrain", {"F0": taut, "ramp": 0.7}, (PLAIN,)))
    with closing(ReferenceSession(model, threads=1, tolerance=1e-10)) as session:
        result = session.solve(wrt=[("tissue", "ramp"), ("tissue", "c1")])
    _, _, exact = response(model, Prestrain("tissue"))
    assert result.force_gradient["tissue", "ramp"][-1] == pytest.approx(-exact.bodies[0, 2], rel=1e-6)
    assert not result.differenced


@pytest.mark.parametrize("what", ["drive", "support"])
def test_a_step_told_from_the_end_of_the_one_before_is_differenced(what: str) -> None:
    """Where the first step ends moves with the law: as if held, the derivative had been twice as large."""
    model = small()
    first, second = (replace(model.steps[0], n_steps=1, step_size=0.5, must_points=()) for _ in range(2))
    if what == "drive":
        model = replace(model, drives=tuple(each for each in model.drives if each.dof != "z"))
        first = replace(first, drives=(Drive("probe", "z", "force", -0.1, "ramp"),))
        second = replace(second, drives=(Drive("probe", "z", "displacement", -0.3, "ramp", True),))
    else:
        second = replace(second, supports=(Support("x1", ("x",), 0.2, "ramp", True),))
    model = replace(model, steps=(first, second))
    with closing(ReferenceSession(model, threads=1, tolerance=1e-10)) as session:
        found = session.solve(wrt=[("tissue", name) for name in ("c1", "c2", "kappa")])
        assert found.differenced
        total = sum(PLAIN.parameters[name] * each for (_, name), each in found.force_gradient.items())
        stiffer = ogden_type(c=0.0052 * 1.001, f_kappa=7.3, m=3.1)
        up = session.solve(model.with_material("tissue", stiffer)).must_points.forces
    assert total == pytest.approx((up - found.must_points.forces) / 0.001, rel=5e-3, abs=1e-6)
    analysis = Analysis(model, TIGHT)
    end = analysis.run()[-1]
    with pytest.raises(SolveError, match="relative to the end of the previous one"):
        sensitivities(analysis.newton, end.state, end.forces, [LawParameter("tissue", {"c1": 1.0})])
    analysis.close()
