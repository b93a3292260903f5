"""Polygons of any number of corners, as lists of corners with the place where each ends."""

from __future__ import annotations

import numpy as np

from limbcli.model import Array, IntArray

# The cells of VTK that are pieces of a surface: their number there, and their corners as plain polygons
# (vtkCellType.h; order of the nodes: VTK File Formats).
_SPLIT = {
    5: [[0, 1, 2]],
    8: [[0, 1, 3, 2]],
    9: [[0, 1, 2, 3]],
    22: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    23: [[0, 4, 7], [4, 1, 5], [5, 2, 6], [6, 3, 7], [4, 5, 6, 7]],
    28: [[0, 4, 8, 7], [4, 1, 5, 8], [8, 5, 2, 6], [7, 8, 6, 3]],
}
_STRIP, _POLYGON = 6, 7
_N_CORNERS = {5: 3, 8: 4, 9: 4, 22: 6, 23: 8, 28: 9}
_VOLUMES = frozenset({10, 11, 12, 13, 14, 24, 25, 26, 27, 29, 42})


@np.errstate(all="ignore")  # coordinates that are no numbers are the reader's to refuse
def triangles_of(points: Array, polygons: IntArray) -> IntArray:
    """Triangles (n (k - 2), 3) of polygons (n, k), each in its plane; points (n_points, 3).

    A fan from the first corner covers a polygon without overlap if all its triangles face alike, as in every
    convex one. The others, as a cut end of a limb may be, are cut ear by ear.

    >>> points = np.array([[0, 0, 0], [4, 0, 0], [1, 1, 0], [0, 4, 0]], float)  # (1, 1) is a corner inwards
    >>> triangles = triangles_of(points, np.array([[1, 2, 3, 0]]))  # a fan would be [1, 2, 3], [1, 3, 0]
    >>> sorted(sorted(each) for each in triangles.tolist())
    [[0, 1, 2], [0, 2, 3]]
    """
    k = np.arange(1, polygons.shape[1] - 1)
    fans: IntArray = polygons[:, np.column_stack([np.zeros_like(k), k, k + 1])]
    if len(k) > 1:
        first, second, third = (points[fans[..., corner]] for corner in range(3))
        normals = np.cross(second - first, third - first)
        whole = normals.sum(axis=1)
        facing = np.einsum("nki,ni->nk", normals, whole)
        for each in np.flatnonzero((facing < -1e-12 * (whole**2).sum(axis=1)[:, None]).any(axis=1)):
            fans[each] = polygons[each][_ears(points[polygons[each]], whole[each])]
    return fans.reshape(-1, 3)


def _ears(corners: Array, normal: Array) -> IntArray:
    """Triangles (k - 2, 3) of one polygon, of corners (k, 3), seen along its normal."""
    import manifold3d

    axis = int(np.argmax(np.abs(normal)))
    seen = [(axis + 1) % 3, (axis + 2) % 3]
    triangles = manifold3d.triangulate([corners[:, seen if normal[axis] > 0 else seen[::-1]]])
    return np.asarray(triangles, np.int64)


def by_length(corners: IntArray, ends: IntArray) -> list[IntArray]:
    """Polygons (n, k), one array for each k: the corners (m,) of all in a row, and the end of each.

    Raises OSError if an end lies before its start or beyond the corners.

    >>> [each.tolist() for each in by_length(np.array([0, 1, 2, 4, 5, 6, 7, 2, 1, 0]), np.array([3, 7, 10]))]
    [[[0, 1, 2], [2, 1, 0]], [[4, 5, 6, 7]]]
    """
    corners, ends = corners.astype(np.int64), ends.astype(np.int64)
    starts, lengths = _pieces(corners, ends)
    return [
        corners[starts[lengths == k][:, None] + np.arange(k)] for k in np.unique(lengths).tolist() if k > 2
    ]


def _pieces(corners: IntArray, ends: IntArray) -> tuple[IntArray, IntArray]:
    """Start and length of each piece of the corners; checked before anything of that length is made."""
    starts = np.r_[0, ends[:-1]].astype(np.int64)
    lengths = ends - starts
    if any(len(each) and not 0 <= each.min() <= each.max() <= len(corners) for each in (lengths, ends)):
        raise OSError("the ends of its polygons do not increase, or lie beyond their corners")
    return starts, lengths


def from_strips(corners: IntArray, ends: IntArray) -> list[IntArray]:
    """The triangles (n, 3) of triangle strips, every second one turned.

    >>> [each.tolist() for each in from_strips(np.array([0, 1, 2, 3]), np.array([4]))]
    [[[0, 1, 2]], [[2, 1, 3]]]
    """
    found = []
    for strip in by_length(corners, ends):
        triples = np.stack([strip[:, :-2], strip[:, 1:-1], strip[:, 2:]], axis=2)
        found += [triples[:, ::2].reshape(-1, 3), triples[:, 1::2][..., [1, 0, 2]].reshape(-1, 3)]
    return found


def from_cells(corners: IntArray, ends: IntArray, types: IntArray) -> list[IntArray]:
    """The polygons of an unstructured grid of VTK; its points and lines are left out.

    Raises OSError if it holds no surface but cells that fill a volume, or a cell has a wrong number of
    corners.
    """
    if len(types) != len(ends):
        raise OSError(f"it has {len(ends)} cells, but types of {len(types)}")
    starts, all_lengths = _pieces(corners, ends)
    found: list[IntArray] = []
    for kind in np.unique(types).tolist():
        chosen = types == kind
        lengths = all_lengths[chosen]
        at = np.concatenate([np.zeros(0, np.int64), *map(np.arange, starts[chosen], ends[chosen])])
        own, own_ends = corners[at.astype(np.int64)], np.cumsum(lengths)
        if kind in _SPLIT:
            if (lengths != _N_CORNERS[kind]).any():
                raise OSError(f"a cell of VTK's type {kind} has not {_N_CORNERS[kind]} corners")
            cells = own.reshape(-1, _N_CORNERS[kind])
            found += [cells[:, part] for part in _SPLIT[kind]]
        elif kind == _POLYGON:
            found += by_length(own, own_ends)
        elif kind == _STRIP:
            found += from_strips(own, own_ends)
    if not found and _VOLUMES & set(types.tolist()):
        raise OSError("it holds cells that fill a volume, and no surface")
    return found
