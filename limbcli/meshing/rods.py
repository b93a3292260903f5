"""Limbs and bones that nobody imaged: round tubes, and rods that lie as deep below the skin as was measured.

A rod's section touches the place where a beam was seen to meet the bone: its nearest line lies there, its
middle one radius further in. Its axis is the limb's own near the sites.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from limbcli.errors import CaseError
from limbcli.meshing.distance import Field, grid_over, signed_distance
from limbcli.meshing.mending import Limb, long_axis
from limbcli.meshing.sections import middle_of, section
from limbcli.meshing.surfaces import Triangles
from limbcli.model import Array

_NEAR_SITE = 70.0  # mm along the limb on either side, of which its axis is that of the sections' middles
_BIN, _FEWEST = 10.0, 5  # mm between sections, and how many make an axis
_CLEAR = 8.0  # mm: a rod ends where it would come nearer to the skin than this
_LEAST_CLEAR, _KEEPS = 1.5, 0.3  # mm inside the skin at its site; the share of it that it keeps
_STEP = 4.0  # mm along a rod at which that is looked at
_LONGER = 3.0  # edges along a rod by those round it
_CELLS = 100  # of the grid along the limb


@dataclass(frozen=True, eq=False)
class Rod:
    """A straight round bone: `centre` (3,) on its `axis` (3,) unit; ends `low`, `high` along it; mm.

    towards : (3,) unit, across the axis: where the first line of the surface lies
    """

    centre: Array
    axis: Array
    radius: float
    low: float
    high: float
    towards: Array

    def depth_under(self, point: Array, beam: Array) -> float | None:
        """mm from a point (3,) along a beam (3,) to the surface; None where the beam passes by."""
        away, along = _across(point - self.centre, self.axis), _across(beam, self.axis)
        a, b, c = along @ along, along @ away, away @ away - self.radius**2
        if b * b < a * c or a < 1e-12:
            return None
        return float((-b - np.sqrt(b * b - a * c)) / a)

    def surface(self, *, edge: float) -> Triangles:
        """Closed, normals outward; its sides are chords of the circle, so `towards` is met exactly.

        edge : mm round the rod; along it, where nothing bends, three times as long
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
    """A limb's skin: round, along z, its middle at the origin, its first line in front (-y)."""
    front = np.array([0.0, -1.0, 0.0])
    return Rod(np.zeros(3), np.array([0.0, 0.0, 1.0]), radius, -length / 2, length / 2, front)


@dataclass(frozen=True, eq=False)
class BoneHit:
    """Where a beam from the skin's `point` (3,) against its `normal` (3,) met bone: `depth` mm down."""

    point: Array
    normal: Array
    depth: float

    @property
    def bone(self) -> Array:
        return self.point - self.depth * self.normal


def limb_axis(limb: Limb, points: Array, proximal: Array) -> Array:
    """Unit vector along the limb near skin points (n, 3): through the middles of its sections there.

    proximal : (3,) unit, roughly along it; where the limb is too short, its longest body decides
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
    """The fewest rods that agree with what was seen, each with the names of the sites that see it.

    Every site alone puts the middle of its rod's section. Sites whose middles lie within one radius of each
    other look at one bone, whose middle is their mean (least squares), the nearest first, in whatever order
    the sites come; others have one each.

    Raises
    ------
    CaseError
        If a rod would stand out of the skin at its site.
    """
    middles = {name: _middle(each, axis, radius) for name, each in seen.items()}
    across = np.array([_across(each, axis) for each in middles.values()])
    groups = [[list(seen)[k] for k in group] for group in _within_reach(across, radius)]
    inside = _inside(limb)
    found = []
    for group in groups:
        centre = _mean([middles[name] for name in group])
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
    """Points (n, 3) in groups that `reach` spans, the nearest joined first; each in order of its numbers.

    >>> _within_reach(np.array([[0.0, 0, 0], [8, 0, 0], [14, 0, 0]]), 9.0)
    [[0], [1, 2]]
    """
    if len(points) < 2:
        return [[k] for k in range(len(points))]
    order = np.lexsort(points.T)  # ties, too, are joined alike in whatever order the points come
    labels = np.empty(len(points), dtype=int)
    labels[order] = fcluster(linkage(points[order], "complete"), reach, "distance")
    return [np.flatnonzero(labels == each).tolist() for each in dict.fromkeys(labels.tolist())]


def _middle(seen: BoneHit, axis: Array, radius: float) -> Array:
    return seen.bone - radius * _unit(_across(seen.normal, axis))


def _mean(points: Sequence[Array]) -> Array:
    return np.asarray(np.mean(points, axis=0))


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
    """The rod, both ways as far as all of its surface stays `clear` mm inside; through cut ends."""
    low, high = limb.skin.points.min(0), limb.skin.points.max(0)
    most = float(np.linalg.norm(high - low))
    ends = []
    for sign in (-1.0, 1.0):
        end = 0.0
        for at in np.arange(_STEP, most, _STEP):
            ring = _ring(rod, sign * at)
            beyond = [each.height(ring).min() > 0 for each in limb.ends]
            if any(beyond):  # all of it has left the limb through a cut
                break
            near_cut = np.any([each.height(ring) > -clear for each in limb.ends], axis=0)
            if (inside.at(ring)[~(near_cut & np.ones(len(ring), bool))] > -clear).any():
                break
            end = sign * at
        ends.append(end)
    return replace(rod, low=ends[0], high=ends[1])
