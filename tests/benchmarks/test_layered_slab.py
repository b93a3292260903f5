"""The layered quarter slab: its sizes, its layers, its borders."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limbcli.errors import MeshError
from limbcli.materials.ogden import ogden_type
from limbcli.meshing.probe import ProbeShape
from tests.benchmarks.layered_slab import LAYERS, CellCounts, Slab, slab_model

PROBE = ProbeShape(40.0, 10.0, 2.4)
LAWS = {name: ogden_type(c=0.01, f_kappa=100.0, m=2.0) for name in LAYERS}


def volumes(model, name: str) -> np.ndarray:
    corners = model.mesh.points[model.mesh.block(name).cells[:, :4]]
    edges = corners[:, 1:] - corners[:, :1]
    return np.linalg.det(edges) / 6


@settings(max_examples=12, deadline=None)
@given(st.floats(0.5, 3.0), st.floats(0.5, 30.0), st.floats(4.0, 60.0), st.floats(5.0, 90.0))
def test_layers_fill_the_quarter_and_no_cell_is_inverted(skin, fat, muscle, margin):
    slab = Slab(skin, fat, muscle, PROBE, margin)
    model = slab_model(slab, LAWS)
    area = (20.0 + margin) * (5.0 + margin)
    for name, thick in zip(LAYERS, (skin, fat, muscle), strict=True):
        found = volumes(model, name)
        assert found.min() > 0
        assert found.sum() == pytest.approx(area * thick)


def test_axis_nodes_are_the_borders_under_the_middle_and_the_probe_starts_inside():
    model = slab_model(Slab(1.5, 6.0, 20.0, PROBE, 30.0), LAWS, start=0.05, counts=CellCounts(fat=3))
    borders = model.mesh.points[model.mesh.node_sets["axis"]]
    assert borders == pytest.approx(np.array([[0, 0, 0], [0, 0, -1.5], [0, 0, -7.5]]))
    assert model.bodies[0].center_of_mass[2] == -0.05
    probe = np.unique(model.mesh.block("probe").cells)
    assert model.mesh.points[probe, 2].min() == pytest.approx(-0.05)


def test_cells_grow_away_from_the_face():
    model = slab_model(Slab(1.5, 6.0, 20.0, PROBE, 60.0), LAWS)
    solid = np.unique(np.concatenate([block.cells[:, :4] for block in model.mesh.solid_blocks]))
    y = np.unique(model.mesh.points[solid, 1].round(9))
    beyond = np.diff(y[y >= 5.0 - 1e-9])
    assert (np.diff(beyond) > 0).all()
    assert y[-1] == pytest.approx(65.0)


def test_a_layer_without_thickness_is_refused():
    with pytest.raises(MeshError, match="layered slab"):
        slab_model(Slab(0.0, 6.0, 20.0, PROBE, 30.0), LAWS)
