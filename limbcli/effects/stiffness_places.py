"""Places in the unloaded tissue, and application of a stiffness field over them to its cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from scipy.spatial import cKDTree

from limbcli.effects.tissue import scaled, skin_points, tissue_block
from limbcli.model import Array, LimbModel, Mesh

_SPLITS = 4  # number of parts of a tetrahedron's edges, for the places sampled in it


@dataclass(frozen=True, eq=False)
class Places:
    """Places (..., 3) in the unloaded tissue (mm, in the site's frame) of one model."""

    at: Array
    model: LimbModel

    @cached_property
    def rows(self) -> Array:
        """The places as a table (n, 3)."""
        return np.ascontiguousarray(self.at.reshape(-1, 3), dtype=float)

    @cached_property
    def below_skin(self) -> Array:
        """Distance (...) to the nearest point of the skin's surface (mm)."""
        distance, _ = skin_tree(self.model).query(self.at.reshape(-1, 3))
        return np.asarray(distance).reshape(self.at.shape[:-1])


Stiffness = Callable[[Places], Array]
_TREES: WeakKeyDictionary[Mesh, cKDTree] = WeakKeyDictionary()
_SAMPLED: WeakKeyDictionary[Mesh, Places] = WeakKeyDictionary()  # the search takes seconds; meshes are reused


def skin_tree(model: LimbModel) -> cKDTree:
    found = _TREES.get(model.mesh)
    if found is None:
        found = _TREES[model.mesh] = cKDTree(skin_points(model))
    return found


def sampled(model: LimbModel) -> Places:
    """Places (35, n_cells, 3) distributed evenly over each of the tissue's cells (by their first four
    corners)."""
    found = _SAMPLED.get(model.mesh)
    if found is None:
        corners = model.mesh.points[tissue_block(model).cells[:, :4]]
        n = _SPLITS
        steps = [
            (i, j, k, n - i - j - k)
            for i in range(n + 1) for j in range(n + 1 - i) for k in range(n + 1 - i - j)
        ]  # fmt: skip
        weights = (np.array(steps) + 0.25) / (n + 1)
        found = _SAMPLED[model.mesh] = Places(np.einsum("wk,nkd->wnd", weights, corners), model)
    return found


def cell_means(model: LimbModel, stiffness: Stiffness) -> Array:
    """Mean of a field over each tissue cell (n_cells,); a layer thinner than an element contributes by its
    volume fraction."""
    return np.asarray(stiffness(sampled(model)).mean(axis=0))


def stiffened(model: LimbModel, stiffness: Stiffness) -> LimbModel:
    """The model with all stiffnesses of its tissue multiplied by a field."""
    return scaled(model, cell_means(model, stiffness))


def layer_share(model: LimbModel, thickness: float) -> Array:
    """Fraction (n_cells,) of each tissue cell that lies in the outermost layer of this thickness (mm)."""
    return cell_means(model, lambda places: (places.below_skin < thickness).astype(float))
