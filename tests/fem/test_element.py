"""Shape functions and integration rules."""

from __future__ import annotations

from itertools import product
from math import factorial

import numpy as np
import pytest
from small_models import block

from limbcli.fem.elements.element import reference_gradients, shape
from limbcli.fem.elements.quadrature import rule

KINDS = ("tet4", "tet10", "hex8", "penta6", "tri3", "tri6", "quad4")


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_derivatives_of_shape_functions(kind: str) -> None:
    points, _ = rule(kind)
    _, dN = shape(kind, points)
    for axis in range(points.shape[1]):
        step = np.zeros(points.shape[1])
        step[axis] = 1e-6
        numeric = (shape(kind, points + step)[0] - shape(kind, points - step)[0]) / 2e-6
        np.testing.assert_allclose(dN[:, :, axis], numeric, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "degree"), [("tet4", 1), ("TET10G4", 2), ("tet10", 3), ("tri3", 2), ("tri6", 5)]
)
def test_rule_integrates_polynomials_of_its_degree(name: str, degree: int) -> None:
    """All monomials: a point at a wrong place may leave the powers of one coordinate right."""
    points, weights = rule(name)
    d = points.shape[1]
    for powers in product(range(degree + 1), repeat=d):
        if sum(powers) <= degree:
            # integral of x^a y^b z^c over the simplex: a! b! c! / (a + b + c + d)!
            exact = np.prod([factorial(each) for each in powers]) / factorial(sum(powers) + d)
            # the ten digits of the rules limit what can be reached
            assert (weights * np.prod(points**powers, axis=1)).sum() == pytest.approx(exact, rel=1e-7)


@pytest.mark.parametrize("name", ["quad4", "hex8"])
def test_gauss_rule_of_a_square_and_a_cube_is_exact_to_cubics(name: str) -> None:
    points, weights = rule(name)
    for powers in product(range(4), repeat=points.shape[1]):
        exact = np.prod([0.0 if each % 2 else 2.0 / (each + 1) for each in powers])
        assert (weights * np.prod(points**powers, axis=1)).sum() == pytest.approx(exact, abs=1e-14)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8", "penta6"])
def test_cells_fill_the_block(kind: str) -> None:
    model = block(kind, (2, 3, 2), (2.0, 3.0, 1.5), twist=0.1)
    cells = model.mesh.block("tissue").cells
    grad, volume = reference_gradients(model.mesh.points, cells, kind, rule(kind))
    assert volume.min() > 0
    assert volume.sum() == pytest.approx(9.0, rel=1e-8)
    # a linear field has its gradient everywhere
    u = model.mesh.points @ np.array([[1.0, 2.0, 3.0], [0.0, -1.0, 4.0], [0.5, 0.0, 2.0]]).T
    H = np.einsum("cni,cgnj->cgij", u[cells], grad)
    np.testing.assert_allclose(H, np.broadcast_to([[1, 2, 3], [0, -1, 4], [0.5, 0, 2]], H.shape), atol=1e-12)
