"""A small residual limb of simple shapes: skin with a round distal end, two sawn bones, patella, femur."""

from __future__ import annotations

import numpy as np
import pytest

from limbcli.meshing import whole_limb
from limbcli.meshing.surfaces import Triangles
from tests.meshing.conftest import tube


def turned(heights, radii, centre=(0.0, 0.0), *, around: int = 36, closed_top: bool = False) -> Triangles:
    """A surface of revolution about z, closed at its lower end; radii[0] must be 0."""
    t = np.linspace(0, 2 * np.pi, around, endpoint=False)
    rings = [
        np.c_[r * np.cos(t), r * np.sin(t), np.full(around, z)]
        for z, r in zip(heights[1:], radii[1:], strict=True)
    ]
    points = [*rings, np.array([[0.0, 0.0, heights[0]]])]
    tip = len(rings) * around
    k, after = np.arange(around), np.roll(np.arange(around), -1)
    faces = [np.c_[np.full(around, tip), after, k]]
    for n in range(len(rings) - 1):
        a, b = n * around, (n + 1) * around
        faces += [np.c_[a + k, a + after, b + after], np.c_[a + k, b + after, b + k]]
    if closed_top:
        points.append(np.array([[0.0, 0.0, heights[-1]]]))
        faces.append(
            np.c_[np.full(around, tip + 1), (len(rings) - 1) * around + k, (len(rings) - 1) * around + after]
        )
    return Triangles(np.vstack(points) + np.array([*centre, 0.0]), np.concatenate(faces).astype(np.int64))


def stump(*, closed_top: bool = False) -> dict[str, Triangles]:
    """Skin (open above) and bones, mm, LPS: a left limb 160 mm long, 80 mm across; the knee is at z = 110."""
    arc = np.linspace(0, np.pi / 2, 9)
    heights = [*(40 * (1 - np.cos(arc))), *np.arange(48.0, 161.0, 8.0)]
    radii = [*(40 * np.sin(arc)), *np.full(15, 40.0)]
    skin = turned(heights, radii, closed_top=closed_top)
    return {
        "skin": skin,
        "bone_tibia": tube((2, -14, 25), (2, -10, 108), (10, 13)),
        "bone_fibula": tube((18, 8, 40), (18, 8, 98), (5, 5), around=24),
        "bone_femur": tube((0, 2, 114), (0, 2, 190), (15, 12)),
        "bone_patella": tube((0, -28, 112), (0, -28, 132), (6, 6), around=24),
    }


def quickly_meshed(patch: pytest.MonkeyPatch) -> None:
    """Mesh a limb once, however many nodes it has, with its distances sampled as those of a large one, 2 mm
    apart and few: together a tenth of the usual work."""
    patch.setattr(whole_limb, "_ATTEMPTS", 1)
    patch.setattr(whole_limb, "_SPACING", (2.0, 2.5))
    patch.setattr(whole_limb, "_SAMPLES", 5e5)
