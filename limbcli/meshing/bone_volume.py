"""Bones of the right volume in facets: nodes stand outside a bent bone by as much as facets cut into it.

Facets with their corners on a convex surface lie inside it: of a thin bone, a coarse mesh may lose a third
that way, and soft tissue takes its place. Here the corners move out until facets lie in equal parts on both
sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from limbcli.meshing.distance import Field, Grid
from limbcli.meshing.domain import BONE, CLEARANCE, TissueDomain
from limbcli.meshing.facets import keep_unfolded
from limbcli.meshing.improve import Ties, put_back
from limbcli.meshing.remesh import Boundary, SizeField
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

_ROUNDS = 3
_WIDTH = 0.75  # of an edge's length: the Gaussian that facets' distances are averaged over
_NEAREST = 24  # facets that such an average takes in
_MOST = 0.35  # of an edge's length, and ...
_TISSUE = 0.25  # ... of the tissue between bone and skin: how far out nodes go at most
_STRIDE = 3  # samples of the bone's grid
_SAMPLES = 5  # a facet's rows of points at which its distance from the bone is looked up


def with_bone_volume(
    boundary: Boundary, domain: TissueDomain, sizes: SizeField
) -> tuple[Boundary, TissueDomain]:
    """The boundary with its nodes on bone moved so that facets enclose the bone's volume everywhere.

    Returns
    -------
    the boundary, and the domain whose bone its nodes lie on: of sharp edges, as far out as `_MOST` allows
    """
    bone = domain.bone
    on_bone = boundary.labels == BONE
    if bone is None or not on_bone.any():
        return boundary, domain
    ties = Ties.of_faces(len(boundary.surface.points), boundary.surface.faces, boundary.labels)
    nodes = np.unique(boundary.surface.faces[on_bone])
    out = _Outwards.none(domain, sizes)
    settled = domain
    for _ in range(_ROUNDS):
        surface = boundary.surface
        out = out.more(Triangles(surface.points, surface.faces[on_bone]), bone)
        settled = replace(domain, bone=out.moved(bone, domain.skin))
        moved = surface.points.copy()
        moved[nodes] = put_back(surface.points, ties, settled)[nodes]
        points = keep_unfolded(surface.points, moved, surface.faces)
        boundary = Boundary(Triangles(points, surface.faces), boundary.labels)
    return boundary, settled


@dataclass(frozen=True, eq=False)
class _Outwards:
    """How far (mm) nodes on bone move outwards: on every third sample, near bone.

    near (nx, ny, nz): the samples it is known at, places (n, 3), edge (n,), most (n,), by (n,) there
    """

    grid: Grid
    near: NDArray[np.bool_]
    places: Array
    edge: Array
    most: Array
    by: Array

    @staticmethod
    def none(domain: TissueDomain, sizes: SizeField) -> _Outwards:
        assert domain.bone is not None
        fine, every = domain.bone.grid, (slice(None, None, _STRIDE),) * 3
        bone, skin = domain.bone.values[every], domain.skin.values[every]
        reach = _MOST * sizes.sizes.far + 2 * _STRIDE * fine.spacing
        near = np.abs(bone) < reach
        grid = Grid(fine.origin, _STRIDE * fine.spacing, bone.shape)
        places = grid.points()[near]
        edge = sizes.at(places)
        most = np.minimum(_MOST * edge, _TISSUE * np.maximum(bone - skin, 0.0)[near])
        return _Outwards(grid, near, places, edge, most, np.zeros(len(places)))

    def more(self, facets: Triangles, bone: Field) -> _Outwards:
        """By what these facets lie inside the bone, averaged over a width of their edges."""
        off = _distances(facets, bone)
        k = min(_NEAREST, len(off))
        distance, at = cKDTree(facets.centroids).query(self.places, k=np.arange(1, k + 1))
        apart = (distance**2 - distance[:, :1] ** 2) / (_WIDTH * self.edge[:, None]) ** 2
        weight = facets.areas[at] * np.exp(-0.5 * apart)
        mean = (weight * off[at]).sum(axis=1) / weight.sum(axis=1)
        return replace(self, by=np.clip(self.by - mean, -self.most, self.most))

    def moved(self, bone: Field, skin: Field) -> Field:
        """The bone's distance with its surface moved so, no nearer to the skin than bone may come."""
        coarse = np.zeros(self.near.shape)
        coarse[self.near] = self.by
        by = Field(self.grid, coarse).at(bone.grid.points().reshape(-1, 3)).reshape(bone.values.shape)
        least = np.minimum(bone.values, skin.values + CLEARANCE)
        return bone.with_values(np.maximum(bone.values - by, least))


def _distances(facets: Triangles, bone: Field) -> Array:
    """Mean distance (n_faces,) mm of facets from the bone, negative inside."""
    n = _SAMPLES
    rows = [(i, j, n - 1 - i - j) for i in range(n) for j in range(n - i)]
    weights = (np.array(rows) + 1.0 / 3.0) / n
    points = np.einsum("sk,fkd->fsd", weights, facets.corners)
    return np.asarray(bone.at(points.reshape(-1, 3)).reshape(points.shape[:2]).mean(axis=1))
