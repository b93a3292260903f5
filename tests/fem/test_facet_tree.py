"""The tree of a surface's facets finds what a look at all of them finds."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.fem.contacts.facet_tree import FacetTree, facets_on_line


@pytest.mark.parametrize("n", [1, 8, 9, 500])
def test_facets_on_a_line_are_those_whose_spheres_it_passes(n: int, rng: np.random.Generator) -> None:
    """With the facets far from where the tree was built: triangles and quadrilaterals, some large."""
    corners = rng.uniform(-10, 10, (n, 1, 3)) + rng.normal(size=(n, 4, 3)) * rng.choice([0.2, 4.0], (n, 1, 1))
    nodes = np.arange(4 * n).reshape(n, 4)
    nodes[::2, 3] = -1
    tree = FacetTree.of(corners.reshape(-1, 3), nodes)
    x = corners.reshape(-1, 3) * [1.0, -2.0, 0.5] + rng.normal(size=(4 * n, 3))
    spheres, around = tree.spheres(x)
    used = [x[each[each >= 0]] for each in nodes]
    assert all(
        (np.linalg.norm(each - s[:3], axis=1) <= s[3]).all() for each, s in zip(used, spheres, strict=True)
    )
    found, n_met = np.empty(n, dtype=np.int64), 0
    for radius in (0.5, 6.0, 100.0):
        for r in rng.uniform(-12, 12, (20, 3)):
            nu = rng.normal(size=3)
            nu /= np.linalg.norm(nu)
            away = spheres[:, :3] - r
            along = away @ nu
            across = np.linalg.norm(away - along[:, None] * nu, axis=1)
            expected = np.flatnonzero((across <= spheres[:, 3]) & (abs(along) <= radius + spheres[:, 3]))
            k = facets_on_line(r, nu, radius, spheres, around, tree.order, tree.starts, found)
            assert found[:k].tolist() == expected.tolist()
            n_met += k
    assert n_met
