"""What a socket must be before a limb is put into it; each reason to refuse has its own message."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import MeshError
from limbcli.meshing.mending import open_rims
from limbcli.meshing.surfaces import Triangles, boundary_loops
from limbcli.model import Array, IntArray
from limbcli.numbers.units import LENGTH_UNITS_IN_MM
from limbcli.sockets.centre_line import CentreLine
from limbcli.sockets.nearest import NearestPoints

_ALIKE = (0.3, 3.0)  # size of a socket, as a multiple of its limb's, that needs no other unit
_LEAST_OVERLAP_MM = 20.0
_SECTORS = 24
_LEAST_AROUND = 0.75  # share of the sectors around the limb that the socket covers
_SLAB_MM = 10.0
# Share of the distance from the skin to the centre line by which the wall may lie inside the skin: chosen.
# Beyond it a facet's normal no longer meets the wall on its own side.
_DEEPEST = 0.35
_HOLE = 0.1  # of a face's extent: a larger hole besides its opening is refused
_ON_MM = 1e-6
_MOST_SQUEEZED = 0.5  # of a liner's thickness: less room than this is refused


@dataclass(frozen=True, eq=False)
class Clearance:
    """How a socket fits: distances (n,), mm, of the skin's points within its height; below 0: the
    skin lies outside the inner face. `points`: which of the skin's points these are."""

    points: IntArray
    distances: Array

    @property
    def deepest_mm(self) -> float:
        return float(max(0.0, -self.distances.min(initial=0.0)))

    @property
    def widest_mm(self) -> float:
        return float(self.distances.max(initial=0.0))


def check_size(socket: Triangles, skin: Triangles, *, where: str = "socket") -> None:
    """Refuse a socket that is in another unit than the limb. Raises MeshError."""
    size, limb = (float(np.linalg.norm(np.ptp(each.points, axis=0))) for each in (socket, skin))
    ratio = size / limb
    if _ALIKE[0] <= ratio <= _ALIKE[1]:
        return
    units = {name: mm for name, mm in LENGTH_UNITS_IN_MM.items() if _ALIKE[0] <= ratio * mm <= _ALIKE[1]}
    likely = min(units, key=lambda name: abs(np.log(ratio * units[name])), default="")
    words = f"as if it were in units of {likely}" if likely else "which no unit of length explains"
    raise MeshError(
        f"the socket is {size:.3g} mm large and the limb {limb:.3g} mm, {words}",
        where=where,
        fix=f"export it in mm{f' (multiply its coordinates by {units[likely]:g})' if likely else ''}",
        size_mm=size,
        limb_mm=limb,
    )


def check_near(socket: Triangles, skin: Triangles, *, where: str = "socket") -> None:
    """Refuse a socket whose box does not meet the limb's. Raises MeshError."""
    apart = np.maximum(
        socket.points.min(axis=0) - skin.points.max(axis=0),
        skin.points.min(axis=0) - socket.points.max(axis=0),
    )
    distance = float(np.linalg.norm(np.maximum(apart, 0.0)))
    if distance > 0:
        raise MeshError(
            f"socket and limb are {distance:.0f} mm apart: they lie in different frames",
            where=where,
            fix="give at least three landmarks on both, or --align",
            distance_mm=distance,
        )


def check_around(face: Triangles, line: CentreLine, *, where: str = "socket") -> None:
    """Refuse an inner face that does not surround the limb. Raises MeshError."""
    height, angle = line.height(face.centroids), line.angles(face.centroids)
    low, high = max(height.min(), line.heights[0]), min(height.max(), line.heights[-1])
    if high - low < _LEAST_OVERLAP_MM:
        raise MeshError(
            f"the socket covers {max(high - low, 0.0):.0f} mm of the limb's length",
            where=where,
            fix="align it (landmarks or --align); for a socket made from the skin give a higher brim_mm",
            overlap_mm=float(high - low),
        )
    # corners as well as centroids: facets may be longer than a slab is high
    samples = np.concatenate([face.centroids, face.points, *(face.corners[:, [k, (k + 1) % 3]].mean(1)
                              for k in range(3))])  # fmt: skip
    height, angle = line.height(samples), line.angles(samples)
    slabs = np.arange(low, high, _SLAB_MM)
    sector = ((angle + np.pi) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    within = (height >= low) & (height <= high)
    cells = np.unique(np.stack([((height - low) // _SLAB_MM).astype(int), sector])[:, within], axis=1)
    share = cells.shape[1] / (max(len(slabs), 1) * _SECTORS)
    if share < _LEAST_AROUND:
        raise MeshError(
            f"the socket covers {100 * share:.0f} % of the way around the limb: it does not surround it",
            where=where,
            fix="give the whole inner face; check that limb and socket are aligned",
            share_around=float(share),
        )


def check_openings(face: Triangles, line: CentreLine, *, where: str = "socket") -> None:
    """Refuse an inner face that opens at the wrong end, or is open elsewhere than there. Raises MeshError."""
    extent = float(np.linalg.norm(np.ptp(face.points, axis=0)))
    rims = sorted(open_rims(face), key=lambda rim: float(line.height(rim[0][None])[0]))  # the brim first
    height = line.height(face.points)
    if rims and line.height(rims[0][0][None])[0] > 0.5 * (height.min() + height.max()):
        raise MeshError(
            "the socket opens at the limb's distal end and is closed towards its proximal one: it is upside "
            "down, or has no brim",
            where=where,
            fix="check how it was exported, or align it (landmarks or --align)",
        )
    holes = [(place, size) for place, size in rims[1:] if size > _HOLE * extent]
    if holes:
        place, size = max(holes, key=lambda rim: rim[1])
        raise MeshError(
            f"the socket is open: besides its brim it has a hole {size:.0f} mm wide at "
            f"({', '.join(f'{each:.0f}' for each in place)}) of the limb's upright frame; a valve's may have "
            f"{_HOLE * extent:.0f} mm",
            where=where,
            fix="close it in the program that made it; the limb must not bulge through it",
            hole_mm=float(size),
        )


def clearance(face: Triangles, skin: Triangles, line: CentreLine, *, where: str = "socket") -> Clearance:
    """How the limb lies in the socket before donning.

    Raises MeshError if the wall lies deeper in the limb than donning can resolve.
    """
    height = line.height(face.points)
    h = line.height(skin.points)
    near = NearestPoints(face)
    beyond = _on_rim(face, *near.of(skin.points))  # of a brim at any height, or a hole: there is no wall
    points = np.flatnonzero((h >= height.min()) & ~beyond)
    found = Clearance(points, near.clearances(skin.points[points]))
    room = np.linalg.norm(skin.points[points] - line.nearest(skin.points[points]), axis=1)
    through = -found.distances - _DEEPEST * room
    if len(points) and through.max() > 0:
        k = int(np.argmax(through))
        place = ", ".join(f"{each:.0f}" for each in skin.points[points[k]])
        raise MeshError(
            f"the socket's wall lies {-found.distances[k]:.0f} mm inside the limb at ({place}) of its "
            f"upright frame, more than {_DEEPEST * room[k]:.0f} mm, which donning can resolve",
            where=where,
            fix="check the alignment, and that the socket belongs to this limb",
            depth_mm=float(-found.distances[k]),
        )
    return found


def _on_rim(face: Triangles, points: Array, facets: IntArray) -> NDArray[np.bool_]:
    """Which points (n, 3) of a face, on its facets (n,), lie on its open rims."""
    on = np.zeros(len(points), bool)
    loops = boundary_loops(face)
    if not loops:
        return on
    begin, end = np.concatenate(loops), np.concatenate([np.roll(each, -1) for each in loops])
    near = np.flatnonzero(np.isin(face.faces[facets], begin).any(axis=1))
    a, side = face.points[begin], face.points[end] - face.points[begin]
    away = points[near, None] - a
    share = np.clip((away * side).sum(axis=2) / (side**2).sum(axis=1), 0.0, 1.0)
    on[near] = np.linalg.norm(away - share[:, :, None] * side, axis=2).min(axis=1) < _ON_MM
    return on


def check_room(before: Clearance, skin: Triangles, thickness: float) -> None:
    """Refuse a liner that the socket would press to less than half of its thickness. Raises MeshError.

    before : of the skin without the liner
    """
    if not len(before.points):
        return
    k = int(np.argmin(before.distances))
    gap = float(before.distances[k])
    if gap < _MOST_SQUEEZED * thickness:
        place = ", ".join(f"{each:.0f}" for each in skin.points[before.points[k]])
        raise MeshError(
            f"the liner of {thickness:g} mm is thicker than the gap of {gap:.1f} mm between skin and socket "
            f"at ({place}) of the limb's upright frame: less than half of it would be left",
            where="[socket.liner]",
            fix="check its thickness and the alignment; a socket scanned over its liner needs none",
            gap_mm=gap,
        )
