"""Derivatives of the probe's force and of displacements against central differences (1e-5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from small_models import punch

from limbcli.fem.analysis import Analysis, Snapshot
from limbcli.fem.field_derivatives import cell_field_derivatives
from limbcli.fem.fields import cell_fields
from limbcli.fem.newton import Settings
from limbcli.fem.rigid import rotation_matrix
from limbcli.fem.sensitivity import BodyMotion, LawParameter, Parameter, Shape, sensitivities
from limbcli.materials import ogden_type
from limbcli.model import ElementMap, LimbModel, Material

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

    check(small(), LawParameter("tissue", name), change, 1e-4 * abs(value))


@pytest.mark.parametrize(("part", "name"), [(1, "ksi"), (1, "alpha"), (1, "beta"), (0, "c1")])
def test_force_by_parameter_of_a_mixture(part: int, name: str) -> None:
    value = FIBRES.parts[part].parameters[name]

    def change(model: LimbModel, h: float) -> LimbModel:
        parts = list(FIBRES.parts)
        parts[part] = parts[part].with_parameters(**{name: value + h})
        return model.with_material("tissue", replace(FIBRES, parts=tuple(parts)))

    check(small("tet4", FIBRES), LawParameter("tissue", name), change, 1e-4 * abs(value))


def test_force_by_map_coefficient(rng: np.random.Generator) -> None:
    n = len(small().mesh.block("tissue").cells)
    base, weights = 0.0026 * (1 + 0.3 * rng.uniform(size=n)), rng.uniform(size=n)

    def mapped(theta: float) -> LimbModel:
        values = ElementMap("c1", "tissue", base + theta * weights)
        return small("tet4", PLAIN.with_parameters(c1=values))

    check(mapped(0.0), LawParameter("tissue", "c1", weights=weights), lambda _, h: mapped(h), 1e-6)


@pytest.mark.parametrize(
    "motion", [(0, 0, 1.0, 0, 0, 0), (0, 0, 0, 0, 1.0, 0), (0.5, 0.2, 1.0, 0.3, 0.3, 0.1)]
)
def test_force_by_probe_offset_and_tilt(motion: tuple[float, float, float, float, float, float]) -> None:
    """Moving or tilting the probe's facets before the load."""

    def change(model: LimbModel, h: float) -> LimbModel:
        body = model.bodies[0]
        center, own = np.array(body.center_of_mass), np.unique(model.mesh.block("probe").cells)
        points = model.mesh.points.copy()
        shift, turn = h * np.array(motion[:3]), rotation_matrix(h * np.array(motion[3:]))
        points[own] = (points[own] - center) @ turn.T + center + shift
        moved = replace(body, center_of_mass=tuple(center + shift))
        return replace(model, mesh=replace(model.mesh, points=points), bodies=(moved,))

    check(small(), BodyMotion("probe", motion), change, 1e-4)


def test_force_by_thickness() -> None:
    """All nodes of the tissue moved in proportion to their depth."""
    model = small()
    directions = np.zeros_like(model.mesh.points)
    tissue = np.unique(model.mesh.block("tissue").cells)
    directions[tissue, 2] = model.mesh.points[tissue, 2] / 8.0

    def change(model: LimbModel, h: float) -> LimbModel:
        return replace(model, mesh=replace(model.mesh, points=model.mesh.points + h * directions))

    check(model, Shape(directions), change, 1e-3)


def test_force_by_parameter_with_tet10() -> None:
    value = PLAIN.parameters["m1"]

    def change(model: LimbModel, h: float) -> LimbModel:
        return model.with_material("tissue", PLAIN.with_parameters(m1=value + h))

    check(small("tet10"), LawParameter("tissue", "m1"), change, 1e-3)


@pytest.mark.parametrize("name", ["c1", "m1", "kappa"])
def test_cell_fields_by_law_parameter(name: str) -> None:
    """J, F and stresses of every cell against central differences of whole solves."""
    fields = ("J", "Fxx", "Fzx", "sz", "sxy", "Ez", "z")
    value = PLAIN.parameters[name]
    h = 1e-4 * abs(value)

    def solved(number: float) -> tuple[Analysis, Snapshot]:
        material = PLAIN.with_parameters(**{name: number})
        analysis = Analysis(small("tet4", material), TIGHT)
        return analysis, analysis.run()[-1]

    analysis, last = solved(value)
    parameter = LawParameter("tissue", name)
    (found,) = sensitivities(analysis.newton, last.state, last.forces, [parameter])
    exact = cell_field_derivatives(analysis.system, last.state, 0, fields, parameter, found)
    sides = []
    for sign in (1, -1):
        other, end = solved(value + sign * h)
        sides.append(cell_fields(other.system, end.state, 0, fields))
    numeric = (sides[0] - sides[1]) / (2 * h)
    np.testing.assert_allclose(
        exact / abs(numeric).max(axis=0), numeric / abs(numeric).max(axis=0), atol=1e-5
    )
