"""Where the local model ends: cutting planes around the probe face, except where the limb itself ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from limbcli.meshing.mending import Limb, Plane
from limbcli.meshing.probe import ProbeShape
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

SPARE = 12.0  # mm: no cut is made where the limb ends less than this beyond the plane
SHORT = 35.0  # mm: an end shorter than this is kept whole if no plane cuts it cleanly
_OUTWARD = np.arange(0.0, 20.0, 1.5)  # mm: trial offsets by which a plane may move outward to cut cleanly
_SIDES = (("x-", 0, -1.0), ("x+", 0, 1.0), ("y-", 1, -1.0), ("y+", 1, 1.0))


def within(points: Array, planes: tuple[Plane, ...] | list[Plane], *, slack: float = 0.0) -> Array:
    """Whether points (n, 3) lie on the kept side of every plane, or at most `slack` mm beyond; (n,)."""
    keep = np.ones(len(points), bool)
    for each in planes:
        keep &= each.height(points) <= slack
    return keep


def crop_planes(limb: Limb, probe: ProbeShape, margin: float) -> tuple[Plane, ...]:
    """Planes `margin` (mm) beyond the probe face on its four sides, and the limb's own cut ends.

    `limb` is in the site's frame. The full thickness (z) is kept. A plane is omitted where less than `SPARE`
    of the limb lies beyond it, and moved outward a little where it would graze the skin or the end of a bone.
    """
    half = (probe.length / 2 + margin, probe.width / 2 + margin)
    ends = list(limb.ends)
    planes: list[Plane] = []
    for name, axis, sign in _SIDES:
        normal = sign * np.eye(3)[axis]
        others = [*ends, *planes]
        reach = limb.skin.points[within(limb.skin.points, others)] @ normal
        if len(reach) == 0 or reach.max() - half[axis] < SPARE:
            continue
        plane = _clean_cut(Plane(normal, half[axis], name), limb, float(reach.max()) - half[axis])
        if plane is not None:
            planes.append(plane)
    kept = limb.skin.points[within(limb.skin.points, planes, slack=5.0)]
    return (*planes, *(each for each in ends if (each.height(kept) > 0).any()))


def _clean_cut(plane: Plane, limb: Limb, beyond: float) -> Plane | None:
    """The plane moved outward to where it grazes least; None if it is better to keep a short end whole."""
    steps = [each for each in _OUTWARD if each <= max(beyond - SPARE / 2, 0.0)]
    moved = [replace(plane, offset=plane.offset + each) for each in steps]
    cost = [5.0 * grazing(each, limb) + step for each, step in zip(moved, steps, strict=True)]
    best = int(np.argmin(cost))
    return None if beyond < SHORT and cost[best] > beyond else moved[best]


def grazing(plane: Plane, limb: Limb) -> float:
    """Area (mm2) of skin or bone close to the plane and nearly parallel to it."""
    total = _area(limb.skin, plane, (-2.0, 1.0), facing=-1.0)
    for each in limb.bones:
        total += _area(each, plane, (-5.0, 1.0), facing=1.0)
    return total


def _area(surface: Triangles, plane: Plane, slab: tuple[float, float], *, facing: float) -> float:
    height = plane.height(surface.centroids)
    near = (height > slab[0]) & (height < slab[1])
    if not near.any():
        return 0.0
    area = Triangles(surface.points, surface.faces[near]).area_vectors
    size = np.linalg.norm(area, axis=1)
    flat = facing * (area @ plane.normal) > 0.75 * size
    return float(size[flat].sum())
