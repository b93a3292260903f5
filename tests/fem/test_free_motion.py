"""Parts of the tissue that nothing holds are named, whatever the precision of the factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_models import block, punch

from limbcli.errors import SolveError
from limbcli.fem.analysis import Analysis
from limbcli.fem.equilibrium.settings import Settings
from limbcli.model import Block, LimbModel, Support


def solved(model: LimbModel, *, single: bool) -> None:
    analysis = Analysis(model, Settings(threads=1, single=single))
    try:
        analysis.run()
    finally:
        analysis.close()


def hinged() -> LimbModel:
    """Held along one edge: free to turn about it."""
    model = block("tet10", (3, 3, 3))
    edge = np.intersect1d(model.mesh.node_sets["x0"], model.mesh.node_sets["z0"])
    mesh = replace(model.mesh, node_sets={**model.mesh.node_sets, "edge": edge})
    return replace(model, mesh=mesh, supports=(Support("edge", ("x", "y", "z")),))


def with_an_island() -> LimbModel:
    """A held block, and another that touches nothing, 30 mm aside."""
    model = punch("tet10", (3, 2, 2))
    n = len(model.mesh.points)
    tissue = model.mesh.block("tissue")
    cells = np.concatenate([tissue.cells, tissue.cells + n])
    others = tuple(b for b in model.mesh.blocks if b.name != "tissue")
    mesh = replace(
        model.mesh,
        points=np.concatenate([model.mesh.points, model.mesh.points + np.array([30.0, 0, 0])]),
        blocks=(Block("tissue", tissue.kind, cells), *others),
    )
    return replace(model, mesh=mesh)


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize(
    ("model", "words", "where"),
    [
        (block("tet10", (3, 3, 3)), "can move freely", "(0.5, 0.5, -0.5)"),
        (hinged(), "about y", "(0.5, 0.5, -0.5)"),
        (with_an_island(), "can move freely", "(36.0, 5.0, -4.0)"),
    ],
)
def test_what_nothing_holds_is_named(model: LimbModel, words: str, where: str, single: bool) -> None:
    with pytest.raises(SolveError, match=words) as caught:
        solved(model, single=single)
    assert where in str(caught.value.where)
    assert "constrain it" in str(caught.value.fix)


@pytest.mark.parametrize("single", [False, True])
def test_three_planes_hold_a_block_and_a_plate_may_push_it(single: bool) -> None:
    model = block("tet10", (3, 3, 3))
    supports = tuple(Support(f"{axis}0", (axis,)) for axis in "xyz")
    solved(replace(model, supports=supports), single=single)
    solved(punch("tet10", (3, 2, 2)), single=single)
