"""Deform a mesh to another shape of skin and bone, keeping its cells and numbering.

A change of force between two independently generated meshes is lost in the scatter from meshing alone (some 3
%). If the nodes of one mesh are moved instead, only the shape changes. Between the surfaces the displacement
of the nodes is the solution of Laplace's equation, component by component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from limbcli.errors import MeshError
from limbcli.meshing.quality import EDGES, volumes
from limbcli.meshing.rods import Rod
from limbcli.model import Array, IntArray, Mesh

LEAST_VOLUME = 0.15  # smallest fraction of its original volume that a cell must keep


def morphed(mesh: Mesh, moves: Mapping[str, Array]) -> Mesh:
    """The mesh with the nodes of some sets moved, and the nodes between them moved by interpolation.

    moves : displacement (n, 3), mm, of the nodes of a node set, in the set's order; if two sets share a node,
        the later one counts. Sets that are not named move freely.

    Raises MeshError if a cell would lose nearly all of its volume.
    """
    cells = np.concatenate([block.cells for block in mesh.solid_blocks])
    corners = cells[:, :4]
    given, at = np.zeros(len(mesh.points), bool), np.zeros((len(mesh.points), 3))
    for name, shift in moves.items():
        nodes = mesh.node_sets[name]
        given[nodes], at[nodes] = True, shift
    moved = at.copy()
    used = np.unique(corners)
    moved[used] = _carried(mesh.points, corners, given, at)[used]
    if cells.shape[1] == 10:
        ends = cells[:, EDGES]
        moved[cells[:, 4:]] = 0.5 * (moved[ends[:, :, 0]] + moved[ends[:, :, 1]])
    points = mesh.points + moved
    least = float((volumes(points, corners) / volumes(mesh.points, corners)).min())
    if least < LEAST_VOLUME:
        raise MeshError(
            f"a cell would keep {100 * least:.0f} % of its volume",
            where="a varied geometry of the limb",
            fix="give the bone's surface, or use a finer mesh (--size-mm)",
        )
    return replace(mesh, points=points)


def _carried(points: Array, corners: IntArray, given: np.ndarray, at: Array) -> Array:
    """Solve Laplace's equation with linear tetrahedra; boundaries without prescribed values are free."""
    edges = np.stack([points[corners[:, k]] - points[corners[:, 0]] for k in (1, 2, 3)], axis=1)
    inverse = np.linalg.inv(edges)
    slopes = np.concatenate([-inverse.sum(axis=2)[:, None], np.swapaxes(inverse, 1, 2)], axis=1)
    weight = np.abs(np.linalg.det(edges)) / 6.0
    local = np.einsum("nad,nbd,n->nab", slopes, slopes, weight)
    rows = np.repeat(corners, 4, axis=1).ravel()
    columns = np.tile(corners, (1, 4)).ravel()
    n = len(points)
    matrix = coo_array((local.ravel(), (rows, columns)), shape=(n, n)).tocsr()
    used = np.zeros(n, bool)
    used[corners] = True
    free, held = np.flatnonzero(used & ~given), np.flatnonzero(used & given)
    found = at.copy()
    if len(free):
        load = -(matrix[free][:, held] @ at[held])
        found[free] = np.asarray(spsolve(matrix[free][:, free].tocsc(), load)).reshape(len(free), 3)
    return found


# ---------------------------------------------------------------- shapes


def wider(points: Array, rod: Rod, factor: float) -> Array:
    """Displacement (n, 3) of points on a rod whose radius is scaled by `factor`; its nearest line stays."""
    away = points - (rod.centre + rod.radius * rod.towards)
    return np.asarray((factor - 1.0) * (away - np.outer(away @ rod.axis, rod.axis)))


def deeper(points: Array, rod: Rod, by: float) -> Array:
    """Displacement (n, 3) of points on a rod that is moved `by` mm deeper."""
    return np.asarray(-by * np.broadcast_to(rod.towards, points.shape))


def flatter(points: Array, rod: Rod, touched: Array, factor: float) -> Array:
    """Displacement (n, 3) of a skin whose section becomes an ellipse, `factor` times as flat at the contact.

    Lengths across grow by the cube root of the factor, those along the beam shrink by it: the radius of
    curvature a^2/b changes by the factor, the circumference hardly.
    """
    root = factor ** (1.0 / 3.0)
    aside = np.cross(rod.axis, rod.towards)
    away = points - touched
    across, down = away @ aside, away @ rod.towards
    return np.asarray(np.outer((root - 1.0) * across, aside) + np.outer((1 / root - 1.0) * down, rod.towards))


def sloping(points: Array, rod: Rod, touched: Array, slope: float) -> Array:
    """Displacement (n, 3) of points on a rod that becomes `slope` mm deeper per mm along its axis.

    touched : (3,) mm, where the depth is unchanged
    """
    along = (points - touched) @ rod.axis
    return np.asarray(-slope * np.outer(along, rod.towards))


def aside(points: Array, rod: Rod, angle: float) -> Array:
    """Displacement (n, 3) of points on a rod moved sideways, so that the beam meets its flank.

    The point where the beam meets the rod stays.

    angle : rad between the beam and the normal of the rod at that point
    """
    side = np.cross(rod.axis, rod.towards)
    shift = rod.radius * ((1.0 - np.cos(angle)) * rod.towards + np.sin(angle) * side)
    return np.asarray(np.broadcast_to(shift, points.shape))


def tapered(points: Array, rod: Rod, touched: Array, rate: float) -> Array:
    """Displacement (n, 3) of a skin whose sections grow by `rate` per mm along the limb.

    Its front line stays.

    touched : (3,) mm, on the front line, at the section whose size is unchanged
    """
    away = points - touched
    along = away @ rod.axis
    return np.asarray((rate * along)[:, None] * (away - np.outer(along, rod.axis)))


def larger(points: Array, touched: Array, factor: float) -> Array:
    """Displacement (n, 3) of a skin scaled by `factor` about the point of contact."""
    return np.asarray((factor - 1.0) * (points - touched))
