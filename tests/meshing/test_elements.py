"""tet4 and tet10 of the same mesh."""

import numpy as np
import pytest

from limbcli.errors import MeshError
from limbcli.meshing.elements import with_element
from limbcli.model import Block, Domain, LimbModel, LogRecord, Material, Mesh, Support, Surface


def model() -> LimbModel:
    """Two tetrahedra on a common face, a rigid triangle above, sets and surfaces."""
    points = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [0, 0, 2], [1, 0, 2], [0, 1, 2]], dtype=float
    )
    cells = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
    mesh = Mesh(
        points,
        (Block("tissue", "tet4", cells), Block("probe", "tri3", np.array([[5, 6, 7]]))),
        {"fixed": np.array([0, 1, 2])},
        {
            "bone": Surface("bone", {"tri3": np.array([[0, 2, 1]])}),
            "probe_face": Surface("probe_face", {"tri3": np.array([[5, 6, 7]])}),
        },
    )
    return LimbModel(
        mesh,
        {"tissue": Material("neo_hooke", {"mu": 1.0, "lambda": 1.0})},
        (Domain("tissue", "tissue"),),
        supports=(Support("fixed", ("x", "y", "z")),),
        records=(LogRecord("node", ("ux",), "nodes.csv", np.arange(5)),),
    )


def test_mid_nodes_lie_halfway_and_the_rigid_part_stays():
    found = with_element(model(), "tet10").mesh
    cells = found.block("tissue").cells
    assert cells.shape == (2, 10)
    ends = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
    for cell in cells:
        for k, (a, b) in enumerate(ends):
            np.testing.assert_allclose(found.points[cell[4 + k]], found.points[cell[[a, b]]].mean(axis=0))
    assert len(found.points) == 8 + 9, "shared edges share their mid-node"
    assert found.surfaces["probe_face"].facets.keys() == {"tri3"}


def test_sets_take_the_mid_nodes_of_their_facets_only():
    found = with_element(model(), "tet10")
    assert len(found.mesh.node_sets["fixed"]) == 6
    assert np.all(found.mesh.points[found.mesh.node_sets["fixed"], 2] == 0.0)
    assert found.mesh.surfaces["bone"].facets["tri6"].shape == (1, 6)
    assert len(found.records[0].items) == 5 + 9


def test_there_and_back_is_the_same_model():
    back = with_element(with_element(model(), "tet10"), "tet4").mesh
    np.testing.assert_array_equal(back.points, model().mesh.points)
    np.testing.assert_array_equal(back.block("tissue").cells, model().mesh.block("tissue").cells)
    np.testing.assert_array_equal(back.node_sets["fixed"], [0, 1, 2])
    np.testing.assert_array_equal(back.surfaces["bone"].facets["tri3"], [[0, 2, 1]])


def test_other_cells_are_refused():
    mesh = Mesh(np.zeros((8, 3)), (Block("tissue", "hex8", np.arange(8)[None]),))
    with pytest.raises(MeshError, match="hex8"):
        with_element(LimbModel(mesh, {}, ()), "tet4")
