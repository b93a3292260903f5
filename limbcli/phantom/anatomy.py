"""A transtibial residual limb defined by formulas: skin, fat, muscle, tibia, fibula, vessels.

Limb frame (mm): x to the subject's left, y posterior, z proximal; the distal tip of the soft tissue is at the
origin. Proximally the limb is unbounded: an image, or a closed surface, cuts it. All shapes are implicit
functions (see `shapes`), so surfaces and label maps can be derived at any resolution.

The proportions are those of a short, slim limb; none is taken from a person.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from limbcli.model import Array, IntArray
from limbcli.phantom.shapes import capsule, gradient, project, rounded_intersection


class Tissue(IntEnum):
    """Tissue at a point, in the order of the signal table in `mri`."""

    AIR = 0
    SKIN = 1
    FAT = 2
    MUSCLE = 3
    CORTEX = 4
    MARROW = 5
    VESSEL = 6
    MARKER = 7


@dataclass(frozen=True, kw_only=True)
class Bone:
    """A long bone with a slightly triangular, tapering section and a bevelled, rounded distal end.

    x, y : position of its axis at z = 0
    lean : (dx/dz, dy/dz) of the axis
    radius, growth : radius of the section at z = 0, and its increase per mm of z
    end : height of the sawn end on the axis
    bevel : outward normal of the end (points distally)
    """

    x: float
    y: float
    lean: tuple[float, float]
    radius: float
    growth: float
    triangularity: float
    turn: float
    end: float
    bevel: tuple[float, float, float]
    cortex: float
    rounding: float = 3.0

    def __call__(self, points: Array) -> Array:
        dx = points[:, 0] - self.x - self.lean[0] * points[:, 2]
        dy = points[:, 1] - self.y - self.lean[1] * points[:, 2]
        angle = np.arctan2(dy, dx) - self.turn
        radius = (self.radius + self.growth * points[:, 2]) * (1 + self.triangularity * np.cos(3 * angle))
        side = np.hypot(dx, dy) - radius
        normal = np.array(self.bevel) / np.linalg.norm(self.bevel)
        at_end = np.array([self.x + self.lean[0] * self.end, self.y + self.lean[1] * self.end, self.end])
        return rounded_intersection(side, (points - at_end) @ normal, radius=self.rounding)


@dataclass(frozen=True, eq=False)
class Capsule:
    """A skin marker: an oil capsule on the skin, its axis along the limb."""

    center: Array
    axis: Array
    half_length: float = 4.0
    radius: float = 3.2

    def __call__(self, points: Array) -> Array:
        reach = self.half_length * self.axis
        return capsule(points, self.center - reach, self.center + reach, self.radius)


@dataclass(frozen=True, eq=False, kw_only=True)
class Anatomy:
    """The whole limb. Half widths (x) and half depths (y): mm at the end of the cap, and mm per mm of z."""

    half_width: float = 43.0
    half_depth: float = 38.5
    growth: float = 0.045
    cap_height: float = 38.0
    cap_power: float = 2.3
    bulge: float = 0.05
    skin_thickness: float = 1.6
    fat_thickness: float = 5.0
    fat_posterior: float = 1.5
    tibia: Bone = Bone(
        x=-5.0, y=-15.0, lean=(-0.02, -0.015), radius=10.2, growth=0.02, triangularity=0.09,
        turn=-np.pi / 2, end=27.0, bevel=(0.0, -0.55, -1.0), cortex=3.4,
    )  # fmt: skip
    fibula: Bone = Bone(
        x=18.5, y=2.0, lean=(0.02, 0.01), radius=5.9, growth=0.005, triangularity=0.06,
        turn=0.4, end=38.0, bevel=(0.45, 0.0, -1.0), cortex=2.2, rounding=2.0,
    )  # fmt: skip
    vessels: tuple[tuple[float, float, float], ...] = ((7.0, 4.0, 1.7), (-2.0, 8.0, 1.4))
    markers: tuple[Capsule, ...] = ()

    def skin(self, points: Array) -> Array:
        """The outer surface: a superellipsoid in the cap, a tapering tube above it."""
        x, y, z = points.T
        scale = self.half_depth / self.half_width
        angle = np.arctan2(y / scale, x)
        section = 1 + self.bulge * (0.6 * np.sin(angle) + 0.4 * np.cos(3 * angle + 0.5))
        width = self.half_width + self.growth * (z - self.cap_height)
        across = np.hypot(x, y / scale) / (section * width)
        below = np.maximum(self.cap_height - z, 0.0) / self.cap_height
        norm = (across**self.cap_power + below**self.cap_power) ** (1 / self.cap_power)
        return (norm - 1.0) * width * scale

    def bones(self) -> dict[str, Bone]:
        return {"tibia": self.tibia, "fibula": self.fibula}

    def bone(self, points: Array) -> Array:
        """Union of both bones."""
        return np.minimum(self.tibia(points), self.fibula(points))

    def fascia_depth(self, points: Array) -> Array:
        """Combined thickness of skin and fat above a point; thicker at the back and at the tip."""
        angle = np.arctan2(points[:, 1], points[:, 0])
        tip = 3.0 * np.exp(-np.maximum(points[:, 2], 0.0) / 20.0)
        return self.skin_thickness + self.fat_thickness + self.fat_posterior * np.sin(angle) + tip

    def vessel(self, points: Array) -> Array:
        """Two vessels behind the interosseous space, running along the limb and ending above the bones."""
        distance = np.full(len(points), np.inf)
        for x, y, radius in self.vessels:
            start, end = np.array([x, y, 45.0]), np.array([x * 1.3, y * 1.1, 1000.0])
            distance = np.minimum(distance, capsule(points, start, end, radius))
        return distance

    def classify(self, points: Array) -> IntArray:
        """The `Tissue` at each point, (n,)."""
        skin = self.skin(points)
        tissue = np.full(len(points), Tissue.AIR, dtype=np.int64)
        tissue[skin < 0] = Tissue.SKIN
        tissue[skin < -self.skin_thickness] = Tissue.FAT
        tissue[skin < -self.fascia_depth(points)] = Tissue.MUSCLE
        tissue[(tissue == Tissue.MUSCLE) & (self.vessel(points) < 0)] = Tissue.VESSEL
        for bone in self.bones().values():
            depth = bone(points)
            tissue[depth < 0] = Tissue.CORTEX
            tissue[depth < -bone.cortex] = Tissue.MARROW
        for marker in self.markers:
            tissue[(marker(points) < 0) & (skin >= 0)] = Tissue.MARKER
        return tissue

    def skin_point(self, *, angle_deg: float, height: float) -> tuple[Array, Array]:
        """Point on the skin at an angle about the limb's axis (0 left, 90 posterior), and the outward normal
        there."""
        angle = np.radians(angle_deg)
        guess = np.array([[self.half_width * np.cos(angle), self.half_depth * np.sin(angle), height]])
        point = project(self.skin, guess)
        normal = gradient(self.skin, point)[0]
        return point[0], normal / np.linalg.norm(normal)

    def with_marker(self, *, angle_deg: float, height: float) -> Anatomy:
        """The same limb with one more marker on its skin."""
        point, normal = self.skin_point(angle_deg=angle_deg, height=height)
        axis = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
        axis /= np.linalg.norm(axis)
        radius = Capsule.radius
        return replace(
            self, markers=(*self.markers, Capsule(center=point + 0.9 * radius * normal, axis=axis))
        )


def random_anatomy(rng: np.random.Generator) -> Anatomy:
    """A different limb for each seed: sizes and positions vary by a few per cent around the default."""
    base = Anatomy()
    size = rng.uniform(0.96, 1.05)
    return replace(
        base,
        half_width=base.half_width * size * rng.uniform(0.98, 1.02),
        half_depth=base.half_depth * size * rng.uniform(0.98, 1.02),
        fat_thickness=rng.uniform(4.0, 6.0),
        bulge=rng.uniform(0.03, 0.06),
        tibia=replace(
            base.tibia,
            x=base.tibia.x + rng.uniform(-1, 1),
            radius=base.tibia.radius * rng.uniform(0.96, 1.05),
        ),
        fibula=replace(base.fibula, y=base.fibula.y + rng.uniform(-1, 1), end=rng.uniform(36.0, 42.0)),
    )
