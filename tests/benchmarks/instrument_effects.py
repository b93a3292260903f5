"""Effects of instruments and operator, applied to readings that have none, as the FEBio study states them.

Parameters have the names, units and meaning of the study's `truth.toml` (its README).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from limbcli.measurement.elastography import SweMap
from limbcli.model import Array

FACE_MM = 8.0  # depth about which a bias with depth is drawn
LEAST_BELOW_CUT_OFF = 0.9  # largest ratio of a drawn guided wave to the speed at which it is cut off


@dataclass(frozen=True, eq=False)
class Readings:
    """One site's levels without noise.

    force (n,) N, depth (n,) mm, travel (n,) mm of the probe; thickness : mm, of the tissue at rest
    maps : one a level
    """

    force: Array
    depth: Array
    travel: Array
    thickness: float
    maps: list[SweMap]

    def with_speeds(self, factors: list[Array]) -> Readings:
        """Readings whose pixels are faster by these factors."""
        pairs = zip(self.maps, factors, strict=True)
        return replace(
            self, maps=[SweMap(each.lateral, each.depth, each.speed_m_per_s * f) for each, f in pairs]
        )


def _force_zero(read: Readings, p: Mapping[str, float]) -> Readings:
    return replace(read, force=read.force + p["f0_n"])


def _depth_zero(read: Readings, p: Mapping[str, float]) -> Readings:
    return replace(read, depth=np.where(read.depth > 0, read.depth - p["d0_mm"], 0.0))


def _preload(read: Readings, p: Mapping[str, float]) -> Readings:
    """From the level at which the probe carries the preload."""
    start = int(np.searchsorted(read.force, p["f0_n"]))
    return Readings(
        read.force[start:] - read.force[start], read.depth[start:] - read.depth[start],
        read.travel[start:] - read.travel[start], read.thickness - read.depth[start], read.maps[start:],
    )  # fmt: skip


def _time_scale(read: Readings, p: Mapping[str, float]) -> Readings:
    return read.with_speeds([np.full(len(each), p["s_t"] ** -0.5) for each in read.maps])


def _depth_bias(read: Readings, p: Mapping[str, float]) -> Readings:
    return read.with_speeds([1.0 - p["beta_per_mm"] * (each.depth - p["z_ref_mm"]) for each in read.maps])


def _guided_wave(read: Readings, p: Mapping[str, float]) -> Readings:
    factors = []
    for each, depth in zip(read.maps, read.depth, strict=True):
        cut_off = 2e-3 * (read.thickness - depth) * p["f_c_hz"]  # m/s
        factors.append((1.0 - (each.speed_m_per_s / cut_off) ** 2) ** -0.5)
    return read.with_speeds(factors)


def _saturation(read: Readings, p: Mapping[str, float]) -> Readings:
    return replace(read, force=p["f_s_n"] * (1.0 - np.exp(-read.force / p["f_s_n"])))


def _support_motion(read: Readings, p: Mapping[str, float]) -> Readings:
    jumped = np.arange(len(read.force)) > p["jump_after_level"]
    return replace(read, travel=read.depth + read.force / p["k_n_per_mm"] + p["jump_mm"] * jumped)


APPLY = {
    "force-zero": _force_zero,
    "depth-zero": _depth_zero,
    "preload": _preload,
    "swe-time-scale": _time_scale,
    "swe-depth-bias": _depth_bias,
    "swe-guided-wave": _guided_wave,
    "load-cell-saturation": _saturation,
    "support-motion": _support_motion,
}
# Effects that are drawn, those that others resemble least: of the force, and where there are maps.
OF_FORCE, OF_MAPS = ("force-zero", "depth-zero", "preload"), ("swe-depth-bias", "swe-guided-wave")


def drawn(read: Readings, has_maps: bool, rng: np.random.Generator) -> tuple[str, dict[str, float]]:
    """An effect and its parameters, in the range of the study's own."""
    sign, size = (-1.0) ** rng.integers(2), rng.uniform()
    name = str(rng.choice(OF_FORCE + OF_MAPS if has_maps else OF_FORCE))
    if name == "swe-guided-wave":
        fastest = max(
            float(np.max(each.speed_m_per_s)) / (2e-3 * (read.thickness - depth))
            for each, depth in zip(read.maps, read.depth, strict=True)
        )
        return name, {"f_c_hz": fastest / (0.6 + (LEAST_BELOW_CUT_OFF - 0.6) * size)}
    return name, {
        "force-zero": {"f0_n": sign * (0.7 + 0.6 * size)},
        "depth-zero": {"d0_mm": sign * (1.0 + size)},
        "preload": {"f0_n": 0.7 + 0.8 * size},
        "swe-depth-bias": {"beta_per_mm": sign * (0.008 + 0.012 * size), "z_ref_mm": FACE_MM},
    }[name]
