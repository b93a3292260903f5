"""Material lines follow the solver's own displacements exactly."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.errors import MeasurementError
from limbcli.feb.settings import schedule
from limbcli.fem.elements.element import shape
from limbcli.site_model.indentation_model import indentation_model
from limbcli.solvers.material_lines import displacements, material_lines
from limbcli.solvers.session import ReferenceSession
from tests.stages.block_case import block_model

DEPTHS = [0.9, 1.8]


@pytest.fixture(scope="module")
def solved():
    model = indentation_model(
        block_model("tet10", counts=(5, 5, 3)), schedule(DEPTHS), c=0.008, f_kappa=20.0, m=3.0
    )
    session = ReferenceSession(model, threads=1)
    try:
        return model, session.solve(records=True).simulation
    finally:
        session.close()


def bent(model, rng):
    """A displacement field (n_points, 3) that quadratic elements hold exactly."""
    a, b, Q = rng.normal(size=3), rng.normal(size=(3, 3)), rng.normal(size=(3, 3, 3)) / 20
    return lambda x: a + x @ b.T + np.einsum("ijk,nj,nk->ni", Q, x, x)


def test_lines_are_exact_for_fields_that_the_elements_hold(rng):
    model = block_model("tet10", counts=(5, 5, 3))
    rest = np.array([0.0, 1.37, 5.9, 11.3, 15.99])
    lines, field = material_lines(model, rest), bent(block_model(), rng)
    u = field(model.mesh.points)[lines.items]
    on_beam = np.column_stack([np.zeros((5, 2)), -rest])
    expected = rest + field(np.zeros((1, 3)))[0, 2] - field(on_beam)[:, 2]
    np.testing.assert_allclose(lines.below_skin(u[:, 2]), expected, atol=1e-9)


def test_lines_are_where_the_solver_puts_their_nodes(solved):
    """At a node of the mesh the line is that node, at any other place what the element says of it."""
    model, simulation = solved
    X = model.mesh.points
    heights = np.unique(X[(np.abs(X[:, :2]) < 1e-9).all(axis=1) & (X[:, 2] > -15.9) & (X[:, 2] < -0.1), 2])
    table = simulation.nodes["nodes.csv"]
    u = np.stack([table.column(name) for name in ("ux", "uy", "uz")], axis=-1)
    number = {tuple(np.round(X[k], 9)): n for n, k in enumerate(table.items)}
    skin = u[:, number[0.0, 0.0, 0.0], 2] if (0.0, 0.0, 0.0) in number else None
    rest = np.r_[-heights, 4.321] if len(heights) else np.array([4.321])
    lines = material_lines(model, rest)
    found = lines.below_skin(displacements(lines, simulation)[..., 2])
    cell, natural = _holding(model, np.array([0.0, 0.0, -4.321]))
    place = {int(k): n for n, k in enumerate(table.items)}
    moved = u[:, [place[int(k)] for k in cell]]
    at_line = np.einsum("n,tnd->td", shape("tet10", natural[None])[0][0], moved)[:, 2]
    top_cell, top = _holding(model, np.array([0.0, 0.0, -1e-9]))
    at_skin = u[:, [place[int(k)] for k in top_cell], 2] @ shape("tet10", top[None])[0][0]
    np.testing.assert_allclose(found[:, -1], 4.321 + at_skin - at_line, atol=1e-6)
    for k, z in enumerate(heights):
        if skin is not None:
            expected = -z + skin - u[:, number[0.0, 0.0, float(np.round(z, 9))], 2]
            np.testing.assert_allclose(found[:, k], expected, atol=1e-9)
    assert np.all(np.diff(found[:, -1]) < 0.05)
    assert found[-1, -1] < 4.321


def _holding(model, x):
    """The cell that holds a place, and its natural coordinates, by the plain loop."""
    for cell in model.mesh.solid_blocks[0].cells:
        corners = model.mesh.points[cell[:4]]
        natural = np.linalg.solve((corners[1:] - corners[0]).T, x - corners[0])
        if natural.min() > -1e-7 and natural.sum() < 1 + 1e-7:
            return cell, natural
    raise AssertionError("no cell holds it")


def test_the_bone_stays_and_lines_beyond_it_are_refused():
    model = block_model("tet10", counts=(5, 5, 3))
    lines = material_lines(model, np.array([4.0, np.nan]))
    u_z = np.where(model.mesh.points[lines.items, 2] > -1e-9, -2.0, 0.0)
    assert lines.rest[1] == pytest.approx(16.0)
    assert lines.below_skin(u_z)[1] == pytest.approx(14.0)
    with pytest.raises(MeasurementError, match=r"17\.0 mm below the skin.*16\.0 mm thick"):
        material_lines(model, np.array([17.0]))


def test_a_beam_beside_the_model_is_refused():
    from dataclasses import replace

    model = block_model()
    beside = replace(model, mesh=replace(model.mesh, points=model.mesh.points + 100.0))
    with pytest.raises(MeasurementError, match="meets no tissue"):
        material_lines(beside, np.array([4.0]))
