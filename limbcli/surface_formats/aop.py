"""Read and write AAOP1 files (.aop) of prosthetics: a limb as radii over angle and height, with landmarks.

The lines of such a file are: comments up to END COMMENTS, the kind of coordinates, the side, landmarks, the
angles, the heights, the radii slice by slice, in mm. The format (American Academy of Orthotists and
Prosthetists) is not published openly; this is what two programs write (ampscan 0.3, MIT, and the clinical
software of its Example.AOP, whose lines end with CR). The frame follows from both: heights grow towards
proximal, angle 0 is in front, and angles turn to the left seen from proximal (turned so, ampscan's file lies
within 0.1 mm of the STL that it was made from, and the tibia's crest of the Example is at 0 degrees).

A landmark's point is three numbers: one that is no radius in mm (5 times the limb's, in the Example), its
angle, and its height. It is placed on the limb's surface there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from limbcli.errors import MeshError
from limbcli.files.atomic import atomic_file
from limbcli.model import Array, IntArray

BoolArray = NDArray[np.bool_]
_END_OF_COMMENTS = "END COMMENTS"
_MAGIC = "AAOP1"
_SIDES = {"LEFT": "left", "RIGHT": "right", "NONE": ""}
_INSET = 0.5  # mm between the ends of a limb and the outermost slices that are written
_TIP = 0.05  # share of its length that counts as the tip
_LEAST = 0.5  # share of the slices that have to surround the axis
_STEP = 3.0  # mm, largest distance of the slices that are written
_N_ANGLES = 72  # radii of a slice
_MOST = 100_000  # angles, heights or landmarks of a plausible file


@dataclass(frozen=True, eq=False)
class AopLimb:
    """angles_deg (n_angles,); heights (n_heights,) mm; radii (n_heights, n_angles) mm.

    side : "left", "right" or "" (not stated); landmarks : (angle in degrees, height in mm) of their points
    (n, 2), by name
    """

    angles_deg: Array
    heights: Array
    radii: Array
    side: str = ""
    landmarks: Mapping[str, Array] = field(default_factory=dict)

    @property
    def points(self) -> Array:
        """(n_heights * n_angles, 3), mm, slice by slice: x to the left, y to the back, z to proximal."""
        angle = np.broadcast_to(self.angles_deg, self.radii.shape)
        height = np.broadcast_to(self.heights[:, None], self.radii.shape)
        return _placed(self.radii.ravel(), angle.ravel(), height.ravel())

    @property
    def landmark_points(self) -> dict[str, Array]:
        """Points (n, 3), mm, of the landmarks on the surface; NaN beyond its heights."""
        from scipy.interpolate import RegularGridInterpolator

        order = np.argsort(self.angles_deg % 360.0)
        around = self.angles_deg[order] % 360.0
        around = np.r_[around[-1] - 360.0, around, around[0] + 360.0]
        radii = self.radii[:, np.r_[order[-1], order, order[0]]]
        upward = np.argsort(self.heights)
        surface = RegularGridInterpolator(
            (self.heights[upward], around), radii[upward], bounds_error=False, fill_value=np.nan
        )
        return {
            name: _placed(surface(np.column_stack([rows[:, 1], rows[:, 0] % 360.0])), rows[:, 0], rows[:, 1])
            for name, rows in self.landmarks.items()
        }

    @property
    def quadrilaterals(self) -> IntArray:
        """(n, 4) corners between neighbouring slices, outward normals; open at both ends."""
        n_heights, n_angles = self.radii.shape
        low = np.arange(n_heights - 1)[:, None] * n_angles
        here, after = low + np.arange(n_angles), low + (np.arange(n_angles) + 1) % n_angles
        corners = np.stack([here, after, after + n_angles, here + n_angles], axis=2).reshape(-1, 4)
        rises = len(self.heights) < 2 or self.heights[-1] > self.heights[0]
        turns = len(self.angles_deg) < 2 or self.angles_deg[1] > self.angles_deg[0]
        return corners if rises == turns else corners[:, ::-1].copy()


def read_aop(path: Path) -> tuple[Array, list[IntArray]]:
    """Points (n, 3), mm, and the quadrilaterals between slices. Raises OSError if it is not such a file."""
    limb = read_aop_limb(path)
    return limb.points, [limb.quadrilaterals]


def read_aop_limb(path: Path) -> AopLimb:
    """The limb of a file with its side and landmarks.

    Raises OSError if it is not an AAOP1 file of cylindrical coordinates, or is damaged.
    """
    text = path.read_bytes().decode("latin-1")
    lines = [each.strip() for each in re.split(r"\r\n|\r|\n", text)]
    if not lines[0].upper().startswith(_MAGIC):
        raise OSError(f"it does not begin with {_MAGIC}")
    ends = [k for k, line in enumerate(lines) if line.upper() == _END_OF_COMMENTS]
    if not ends:
        raise OSError(f"{_END_OF_COMMENTS} is missing")
    rest = _Lines([each for each in lines[ends[0] + 1 :] if each])
    kind = rest.word()
    if kind.upper() != "CYLINDRICAL":
        raise OSError(f"its coordinates are {kind[:20]}; only CYLINDRICAL is read")
    side = rest.word().upper()
    if side not in _SIDES:
        raise OSError(f"its side is {side[:20]!r}, which is none of {', '.join(_SIDES)}")
    landmarks = {}
    for _ in range(rest.count("landmarks")):
        name = rest.word()
        rows = np.array([rest.numbers(3) for _ in range(rest.count("points of a landmark"))]).reshape(-1, 3)
        landmarks[name] = rows[:, 1:]
    angles, heights = rest.axis("angles", closed=True), rest.axis("heights", closed=False)
    radii = rest.numbers(len(angles) * len(heights)).reshape(len(heights), len(angles))
    if rest.at < len(rest.lines):
        raise OSError(f"{len(rest.lines) - rest.at} lines follow the radii")
    if (radii < 0).any():
        raise OSError("a radius is negative")
    return AopLimb(angles, heights, radii, _SIDES[side], landmarks)


def _placed(radius: Array, angle_deg: Array, height: Array) -> Array:
    """Points (n, 3): angle 0 in front (-y), 90 degrees to the left (+x)."""
    angle = np.deg2rad(angle_deg)
    return np.stack([radius * np.sin(angle), -radius * np.cos(angle), height], axis=1)


@dataclass
class _Lines:
    lines: list[str]
    at: int = 0

    def word(self) -> str:
        if self.at >= len(self.lines):
            raise OSError("it ends before all that it tells of")
        self.at += 1
        return self.lines[self.at - 1]

    def numbers(self, count: int) -> Array:
        try:
            found = np.array([float(self.word()) for _ in range(count)])
        except ValueError as error:
            raise OSError(f"line {self.lines[self.at - 1][:20]!r} is not a number") from error
        if not np.isfinite(found).all():
            raise OSError("a number is not finite")
        return found

    def count(self, what: str) -> int:
        (number,) = self.numbers(1)
        if number != int(number) or not 0 <= number <= _MOST:
            raise OSError(f"its number of {what} is {number:g}")
        return int(number)

    def axis(self, what: str, *, closed: bool) -> Array:
        """Angles or heights: their number and step; or 0 for the step, and each of them."""
        count = self.count(what)
        if count < (3 if closed else 2):
            raise OSError(f"it has {count} {what}")
        (step,) = self.numbers(1)
        values = self.numbers(count) if step == 0 else step * np.arange(count)
        rises = np.diff(values)
        if not ((rises > 0).all() or (rises < 0).all()):
            raise OSError(f"its {what} are not in order")
        if closed and abs(values[-1] - values[0]) >= 360.0:
            raise OSError(f"its {what} span a whole turn or more")
        return np.asarray(values)


# ---------------------------------------------------------------- writing


def aop_limb(
    points: Array, triangles: IntArray, *, side: str = "", landmarks: Mapping[str, Array] | None = None
) -> tuple[AopLimb, Array]:
    """A surface as radii about an upright axis, and the point (3,), mm, of the axis at height 0.

    The axis is that through the tip or through the whole limb, whichever more slices surround. What lies
    beyond these slices is left out: the last mm of a tip beside it, an uneven upper rim.

    points : (n, 3), mm, z along the limb to proximal, y to the back; triangles : (m, 3); landmarks : points
    (n, 3) on the surface by name. Where a slice has several crossings at an angle, the outermost counts.

    Raises MeshError if few slices surround the axis: the limb lies across z, or the surface has holes.
    """
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    inset = min(_INSET, 0.01 * (high - low))
    n_heights = max(2, int(np.ceil((high - low) / _STEP)) + 1)
    heights = np.linspace(low + inset, high - inset, n_heights)
    angles = np.arange(_N_ANGLES, dtype=np.float64) * 360.0 / _N_ANGLES
    directions = _placed(np.ones(_N_ANGLES), angles, np.zeros(_N_ANGLES))[:, :2]
    tip = points[points[:, 2] < low + _TIP * (high - low)][:, :2].mean(axis=0)
    best, axis, radii = slice(0, 0), np.zeros(3), np.zeros((0, _N_ANGLES))
    for middle in (tip, _middle(points[triangles])):
        corners = points[triangles] - np.append(middle, 0.0)
        rows = np.array([_outermost(_section(corners, height), directions) for height in heights])
        whole = _longest_run(np.asarray((rows > 0).all(axis=1)))
        if whole.stop - whole.start > best.stop - best.start:
            best, axis, radii = whole, np.append(middle, heights[whole.start]), rows[whole]
    if len(radii) < max(2, _LEAST * n_heights):
        raise MeshError(
            f"only {len(radii)} of {n_heights} slices of the limb's surface surround its axis",
            where="AOP file",
            fix="turn the limb upright (z to proximal), and close holes of its surface",
        )
    heights = heights[best]
    found = {}
    for name, places in (landmarks or {}).items():
        own = np.atleast_2d(places) - axis
        found[name] = np.column_stack([np.degrees(np.arctan2(own[:, 0], -own[:, 1])), own[:, 2]])
    return AopLimb(angles, heights - heights[0], radii, side, found), axis


def write_aop(path: Path, limb: AopLimb, *, comments: Sequence[str] = ()) -> None:
    """Write a limb as ampscan does: even angles by their step, heights one by one, lines ending with LF."""
    side = next(word for word, own in _SIDES.items() if own == limb.side)
    lines = [
        _MAGIC,
        _MAGIC,
        *(" ".join(each.split()) for each in comments),
        _END_OF_COMMENTS,
        "CYLINDRICAL",
        side,
    ]
    lines.append(str(len(limb.landmarks)))
    for name, places in limb.landmark_points.items():
        lines += [" ".join(name.split()) or "landmark", str(len(places))]
        for (angle, height), point in zip(limb.landmarks[name], places, strict=True):
            lines += [_number(float(np.hypot(*point[:2]))), _number(angle), _number(height)]
    lines += [str(len(limb.angles_deg)), _number(limb.angles_deg[1] - limb.angles_deg[0])]
    lines += [str(len(limb.heights)), "0", *map(_number, limb.heights), *map(_number, limb.radii.ravel())]
    with atomic_file(path) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="ascii", errors="replace", newline="\n")


def _number(value: float) -> str:
    return f"{value if np.isfinite(value) else 0.0:.6f}"


def _longest_run(chosen: BoolArray) -> slice:
    """
    >>> _longest_run(np.array([False, True, True, False, True]))
    slice(1, 3, None)
    """
    edges = np.flatnonzero(np.diff(np.r_[False, chosen, False].astype(int))).reshape(-1, 2)
    if not len(edges):
        return slice(0, 0)
    first, last = edges[np.argmax(edges[:, 1] - edges[:, 0])].tolist()
    return slice(first, last)


def _middle(corners: Array) -> Array:
    """The mean (2,) of the triangles' centres, weighted by their areas, across z."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return np.asarray(np.average(corners.mean(axis=1)[:, :2], axis=0, weights=area))


def _section(corners: Array, height: float) -> Array:
    """Both ends (n, 2, 2) of the lines in which triangles (m, 3, 3) cross a height."""
    above = corners[..., 2] > height
    crossing = corners[above.any(axis=1) & ~above.all(axis=1)]
    first, second = crossing, np.roll(crossing, -1, axis=1)
    cut = (first[..., 2] > height) != (second[..., 2] > height)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (height - first[..., 2]) / (second[..., 2] - first[..., 2])
        places = first[..., :2] + share[..., None] * (second - first)[..., :2]
    return places[cut].reshape(-1, 2, 2)


def _outermost(lines: Array, directions: Array) -> Array:
    """The largest distance (k,) at which rays from the origin along (k, 2) cross lines (n, 2, 2); else 0."""
    along = directions @ lines.reshape(-1, 2).T
    across = (directions @ [[0.0, 1.0], [-1.0, 0.0]]) @ lines.reshape(-1, 2).T
    along, across = along.reshape(len(directions), -1, 2), across.reshape(len(directions), -1, 2)
    begins, ends = across[..., 0], across[..., 1]
    crosses = (begins > 0) != (ends > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = begins / (begins - ends)
        distance = along[..., 0] + share * (along[..., 1] - along[..., 0])
    return np.asarray(np.where(crosses, distance, 0.0).max(axis=1, initial=0.0))
