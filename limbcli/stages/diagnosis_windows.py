"""The scanner's region cut into parts: what a map's pixels and a model's cells belong to."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from limbcli.measurement.elastography import SweMap
from limbcli.measurement.swe_prediction import Window
from limbcli.model import Array, IntArray

_FEWEST_CELLS, _FARTHEST = 6, 12.0  # of a part of the window; mm from its middle


@dataclass(frozen=True)
class Windows:
    """The scanner's region cut into parts: the whole of it first, then `across` x `down` cells."""

    window: Window = field(default_factory=Window)
    across: int = 3
    down: int = 3

    @property
    def depths(self) -> Array:
        """Middle of each part below the face (mm), the whole first."""
        w = self.window
        edges = np.linspace(w.depth_from, w.depth_to, self.down + 1)
        middles = 0.5 * (edges[1:] + edges[:-1])
        return np.concatenate([[0.5 * (w.depth_from + w.depth_to)], np.repeat(middles, self.across)])

    def names(self) -> list[str]:
        sides = ["left", "middle", "right"] if self.across == 3 else [str(k) for k in range(self.across)]
        levels = ["shallow", "mid-depth", "deep"] if self.down == 3 else [str(k) for k in range(self.down)]
        return ["whole", *(f"{depth} {side}" for depth in levels for side in sides)]

    def members(self, places: Array, face: float) -> list[IntArray]:
        """The cells, at `places` (n_cells, 3) mm, in every part of the window below a face at this height.

        A part in which there are few cells (they are larger than the part) takes those nearest to its
        middle; none where the tissue ends above it.
        """
        w, depth = self.window, face - places[:, 2]
        near = (np.abs(places[:, 0]) <= w.half_width) & (np.abs(places[:, 1]) <= 2 * w.elevation)
        near &= (depth >= w.depth_from) & (depth <= w.depth_to)
        part = self._part(places[:, 0], depth)
        found = [np.flatnonzero(near)]
        for k, (x, z) in enumerate(self._middles()):
            inside = np.flatnonzero(near & (part == k))
            if len(inside) < _FEWEST_CELLS:
                away = np.hypot(np.hypot(places[:, 0] - x, places[:, 1]), depth - z)
                nearest = np.argsort(away)[:_FEWEST_CELLS]
                inside = nearest[away[nearest] < _FARTHEST]
            found.append(inside)
        return found

    def _middles(self) -> list[tuple[float, float]]:
        """Lateral place and depth of each part's middle (mm), row by row downwards."""
        w = self.window
        x = w.half_width * (2 * np.arange(self.across) + 1 - self.across) / self.across
        z = w.depth_from + (w.depth_to - w.depth_from) * (np.arange(self.down) + 0.5) / self.down
        return [(float(a), float(b)) for b in z for a in x]

    def _part(self, lateral: Array, depth: Array) -> IntArray:
        w = self.window
        column = np.floor((lateral + w.half_width) / (2 * w.half_width + 1e-9) * self.across)
        row = np.floor((depth - w.depth_from) / (w.depth_to - w.depth_from + 1e-9) * self.down)
        return np.asarray(row * self.across + column).astype(np.int64)

    def log_means(self, swe: SweMap) -> tuple[Array, Array]:
        """ln of the mean speed and the pixel count of every part: (1 + across * down,) each."""
        part = self._part(swe.lateral, swe.depth)
        means, counts = [np.log(swe.speed_m_per_s.mean())], [len(swe)]
        for k in range(self.across * self.down):
            inside = part == k
            counts.append(int(inside.sum()))
            means.append(np.log(swe.speed_m_per_s[inside].mean()) if inside.sum() >= 4 else np.nan)
        return np.array(means), np.array(counts)
