"""The inner face of a socket: the side of a surface that the limb sees, with its normals towards the limb.

A file holds either the inner face alone (an open sheet) or the socket's wall (closed, with a thickness).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from limbcli.errors import MeshError
from limbcli.meshing.mending import open_rims, turned_inward
from limbcli.meshing.surfaces import Triangles, bodies, undirected
from limbcli.model import Array
from limbcli.sockets.centre_line import CentreLine

_WIDE = 0.25  # a rim is an opening for the limb above this fraction of the surface's extent
_MOST_TURNED = 0.1  # share of an open sheet's area that may face away from the limb


def inner_face(surface: Triangles, line: CentreLine, *, where: str = "socket") -> Triangles:
    """The inner face of a socket in the limb's frame.

    Of a wall, the largest connected part that faces the limb's centre line; where a wall has several such
    parts (an inner and an outer shell), that nearest to it.

    surface : mm, aligned with the limb
    line : centre line of the limb

    Returns triangles with normals towards the limb.

    Raises MeshError if neither a sheet nor a wall is found, or its facets are not oriented alike.
    """
    pieces = bodies(surface)
    extent = float(np.linalg.norm(np.ptp(pieces[0].points, axis=0)))
    sheet = sum(size > _WIDE * extent for _, size in open_rims(pieces[0])) > 0
    if sheet:
        face = pieces[0] if turned_inward(pieces[0]) else pieces[0].flipped()
        turned = 1.0 - _facing(face, line) @ face.areas / face.areas.sum()
        if turned > _MOST_TURNED:
            raise MeshError(
                f"{100 * turned:.0f} % of the socket's inner face points away from the limb: it is partly "
                "inside out",
                where=where,
                fix="orient its triangles alike (MeshLab: Re-Orient all faces coherently), or give the wall "
                "as a closed surface",
                share_turned=float(turned),
            )
        return face
    parts = []
    for piece in pieces:
        wall = piece.flipped() if turned_inward(piece) else piece
        facing = np.flatnonzero(_facing(wall, line))
        if len(facing):
            parts += _connected(wall.part(facing))
    if not parts:
        raise MeshError(
            "no side of the socket faces the limb: the limb does not lie inside it",
            where=where,
            fix="align it (landmarks or --align), or give its inner face as an open surface",
        )
    largest = max(float(each.areas.sum()) for each in parts)
    large = [each for each in parts if each.areas.sum() > 0.5 * largest]
    return min(large, key=lambda each: _distance(each, line))


def _facing(surface: Triangles, line: CentreLine) -> Array:
    """Which facets (n_facets,) face the centre line."""
    inward = line.nearest(surface.centroids) - surface.centroids
    return np.asarray(np.einsum("ij,ij->i", surface.area_vectors, inward) > 0)


def _distance(part: Triangles, line: CentreLine) -> float:
    away = np.linalg.norm(part.centroids - line.nearest(part.centroids), axis=1)
    return float(np.average(away, weights=part.areas))


def _connected(surface: Triangles) -> list[Triangles]:
    """The parts of a surface whose facets share edges."""
    n = len(surface.faces)
    edges = undirected(surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))
    order = np.argsort(edges, kind="stable")
    same = np.flatnonzero(edges[order][1:] == edges[order][:-1])
    a, b = order[same] // 3, order[same + 1] // 3
    _, label = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)
    return [surface.part(label == k) for k in np.unique(label)]
