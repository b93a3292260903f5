"""Limbs and bones that were not imaged: round tubes, and round rods at the measured depth below the skin.

A rod's cross-section touches the point where an ultrasound beam met the bone: the line of the rod nearest the
skin passes through it, and the centre lies one radius deeper. Its axis is that of the limb near the sites.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from limbcli.errors import CaseError
from limbcli.meshing.distance import Field, grid_over, signed_distance
from limbcli.meshing.mending import Limb, long_axis
from limbcli.meshing.sections import middle_of, section
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

# mm along the limb on either side of the sites; the axis is fitted to the centres of the sections in this
# range
_NEAR_SITE = 70.0
_BIN, _FEWEST = 10.0, 5  # mm between sections, and the smallest number of sections for an axis
_CLEAR = 8.0  # mm: a rod ends where it would come closer to the skin than this
# smallest clearance (mm) of a rod from the skin at its site; fraction of it required along the rod
_LEAST_CLEAR, _KEEPS = 1.5, 0.3
_STEP = 4.0  # mm between the positions along a rod at which the clearance is checked
_LONGER = 3.0  # ratio of the edge length along a rod to that round it
_CELLS = 100  # number of grid cells along the longest side of the limb


@dataclass(frozen=True, eq=False)
class Rod:
    """A straight round bone: `centre` (3,) on its unit `axis` (3,); ends `low`, `high` along it; mm.

    towards : (3,) unit, across the axis: direction of the first line of the surface
    """

    centre: Array
    axis: Array
    radius: float
    low: float
    high: float
    towards: Array

    def depth_under(self, point: Array, beam: Array) -> float | None:
        """Distance (mm) from a point (3,) along a beam (3,) to the surface; None if the beam misses it."""
        away, along = _across(point - self.centre, self.axis), _across(beam, self.axis)
        a, b, c = along @ along, along @ away, away @ away - self.radius**2
        if b * b < a * c or a < 1e-12:
            return None
        return float((-b - np.sqrt(b * b - a * c)) / a)

    def surface(self, *, edge: float) -> Triangles:
        """The closed surface, normals outward; its sides are chords of the circle, one vertex at `towards`.

        edge : mm, edge length round the rod; along it, where it is straight, three times as long
        """
        around = max(24, int(np.ceil(2 * np.pi * self.radius / edge)))
        rings = max(1, int(np.ceil((self.high - self.low) / (_LONGER * edge))))
        angle = 2 * np.pi * np.arange(around) / around
        aside = np.cross(self.axis, self.towards)
        ring = self.radius * (np.outer(np.cos(angle), self.towards) + np.outer(np.sin(angle), aside))
        at = np.linspace(self.low, self.high, rings + 1)
        side = (at[:, None, None] * self.axis + ring[None]).reshape(-1, 3)
        ends = np.array([self.low, self.high])[:, None] * self.axis
        points = np.vstack([side, ends]) + self.centre
        return Triangles(points, _faces(around, rings))


def _faces(around: int, rings: int) -> np.ndarray:
    k = np.arange(around)
    after = (k + 1) % around
    first, second = len(k) * (rings + 1), len(k) * (rings + 1) + 1
    found = []
    for ring in range(rings):
        a, b = ring * around, (ring + 1) * around
        found += [np.stack([a + k, a + after, b + k], 1), np.stack([a + after, b + after, b + k], 1)]
    top = rings * around
    found += [np.stack([after, k, np.full(around, first)], 1)]
    found += [np.stack([top + k, top + after, np.full(around, second)], 1)]
    return np.concatenate(found).astype(np.int64)


def tube(radius: float, length: float) -> Rod:
    """The skin of a limb: a round tube along z, centred at the origin, its first line in front (-y)."""
    front = np.array([0.0, -1.0, 0.0])
    return Rod(np.zeros(3), np.array([0.0, 0.0, 1.0]), radius, -length / 2, length / 2, front)


@dataclass(frozen=True, eq=False)
class BoneHit:
    """A beam from a skin `point` (3,) against its `normal` (3,) that met bone `depth` mm below the skin."""

    point: Array
    normal: Array
    depth: float

    @property
    def bone(self) -> Array:
        return self.point - self.depth * self.normal


def limb_axis(limb: Limb, points: Array, proximal: Array) -> Array:
    """Unit vector along the limb near skin points (n, 3), fitted to the centres of its sections there.

    proximal : (3,) unit, roughly along it; if the limb is too short, its `long_axis` is
        used
    """
    along = limb.skin.points @ proximal
    reach = points @ proximal
    low = max(reach.min() - _NEAR_SITE, along.min() + _BIN)
    high = min(reach.max() + _NEAR_SITE, along.max() - _BIN)
    middles = []
    for height in np.arange(low, high + 1e-9, _BIN):
        pieces = section(limb.skin, height * proximal, proximal)
        if len(pieces) > 8:
            middles.append(middle_of(pieces))
    if len(middles) < _FEWEST:
        axis = long_axis([limb.skin, *limb.bones])
    else:
        found = np.array(middles)
        axis = np.linalg.svd(found - found.mean(axis=0))[2][0]
    return axis if axis @ proximal > 0 else -axis


def rods_for(
    seen: Mapping[str, BoneHit], limb: Limb, axis: Array, radius: float
) -> list[tuple[Rod, list[str]]]:
    """The fewest rods that agree with the measured depths, each with the names of its sites.

    Each site determines the centre of its rod's section. Sites whose centres lie within one radius of each
    other belong to the same bone, whose centre is their mean (least squares); the nearest are joined first,
    whatever the order of the sites. Other sites have a rod each.

    Raises CaseError if a rod would protrude from the skin at its site.
    """
    middles = {name: each.bone - radius * _unit(_across(each.normal, axis)) for name, each in seen.items()}
    across = np.array([_across(each, axis) for each in middles.values()])
    groups = [[list(seen)[k] for k in group] for group in _within_reach(across, radius)]
    inside = _inside(limb)
    found = []
    for group in groups:
        centre = np.mean([middles[name] for name in group], axis=0)
        towards = _unit(_across(seen[group[0]].normal, axis))
        rod = Rod(centre, axis, radius, 0.0, 0.0, towards)
        here = -float(inside.at(_ring(rod, 0.0)).max())
        if here < _LEAST_CLEAR:
            depth = min(seen[name].depth for name in group)
            raise CaseError(
                f"a bone of {radius:g} mm radius, {depth:g} mm below the skin, does not lie within the limb",
                where=f"site {', '.join(group)}",
                fix="give a smaller bone_radius_mm; check the distance to the bone, and position_mm",
            )
        clear = min(_CLEAR, max(_LEAST_CLEAR, _KEEPS * here))
        found.append((_as_long_as_inside(rod, limb, inside, clear), group))
    return found


def _within_reach(points: Array, reach: float) -> list[list[int]]:
    """Group points (n, 3) by complete linkage with diameter `reach`, the nearest first.

    Indices within a group are in ascending order.

    >>> _within_reach(np.array([[0.0, 0, 0], [8, 0, 0], [14, 0, 0]]), 9.0)
    [[0], [1, 2]]
    """
    if len(points) < 2:
        return [[k] for k in range(len(points))]
    order = np.lexsort(points.T)  # so that ties are resolved independently of the order of the points
    labels = np.empty(len(points), dtype=int)
    labels[order] = fcluster(linkage(points[order], "complete"), reach, "distance")
    return [np.flatnonzero(labels == each).tolist() for each in dict.fromkeys(labels.tolist())]


def _across(vector: Array, axis: Array) -> Array:
    return np.asarray(vector - (vector @ axis) * axis)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _inside(limb: Limb) -> Field:
    low, high = limb.skin.points.min(0), limb.skin.points.max(0)
    spacing = float(max((high - low).max() / _CELLS, 0.8))
    return signed_distance(limb.skin, grid_over(low - 2.5 * spacing, high + 2.5 * spacing, spacing))


def _ring(rod: Rod, at: float) -> Array:
    return replace(rod, low=at - 1e-6, high=at).surface(edge=_STEP).points


def _as_long_as_inside(rod: Rod, limb: Limb, inside: Field, clear: float) -> Rod:
    """The rod, extended both ways while its surface stays `clear` mm inside; it may pass cut ends."""
    low, high = limb.skin.points.min(0), limb.skin.points.max(0)
    most = float(np.linalg.norm(high - low))
    ends = []
    for sign in (-1.0, 1.0):
        end = 0.0
        for at in np.arange(_STEP, most, _STEP):
            ring = _ring(rod, sign * at)
            beyond = [each.height(ring).min() > 0 for each in limb.ends]
            if any(beyond):  # the whole ring is beyond a cut
                break
            near_cut = np.any([each.height(ring) > -clear for each in limb.ends], axis=0)
            if (inside.at(ring)[~(near_cut & np.ones(len(ring), bool))] > -clear).any():
                break
            end = sign * at
        ends.append(end)
    return replace(rod, low=ends[0], high=ends[1])
