"""Noise of a site's data: the stated noise of the readings, and the known errors of the model.

Depth is the noisy reading; force and speeds are compared at the measured depth. An error e_d of the depth
therefore shifts force, speeds and travel of a level together, which the covariance includes:
residual of the force -K e_d, of ln speed -s e_d, of the travel -e_d (K, s: measured slopes).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limbcli.case import StatedNoise
from limbcli.diagnosis.data.rows import LAYER, TRAVEL_DEVIATION, SiteReadings, SiteRows, SmoothDepth, within
from limbcli.diagnosis.data.windows import Windows, pitch_of
from limbcli.diagnosis.explanations.noise import NoisePart, common, correlated, independent, of_groups
from limbcli.effects.reading import Protocol
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.map_noise import PixelNoise, pixel_noise
from limbcli.model import Array, IntArray
from limbcli.site_model.layer_readings import LayerReadings

GAIN_OF_SPEEDS = "gain of all speeds"
COMPRESSIBILITY = "model: f-kappa"
STRAIN = "model: strain by the thickness"
# Standard deviation of a common factor on all speeds: the scanner's calibration (assumed, as it is never
# stated). The models' own error there is 0.2 % or less at rest (`tests/benchmarks/map_errors.py`).
COMMON_GAIN = 0.02
# Model error in a map: standard deviation of ln speed at the top of the map, per unit of strain (depth over
# thickness) to the power _GROWS; a share _EVERYWHERE of it at any depth below the face, the rest decays over
# _FADES_MM. Beside bone, where a map shows nothing, it is 1 + _AT_BONE times as large, and this excess decays
# over _FROM_BONE_MM: tissue between probe and bone is squeezed most, and meshes differ most there. It is
# correlated exponentially over _NEAR_MM, and by _ALIKE between neighbouring levels. The likeliest of tied
# models against noise-free FEBio models at thirteen sites (`tests/benchmarks/map_errors.py`), with a size as
# at the worst of them; the fraction that applies is estimated with every explanation.
_BELOW_FACE, _EVERYWHERE, _GROWS, _FADES_MM, _NEAR_MM, _ALIKE = 0.32, 0.17, 1.2, 12.0, 9.0, 0.88
_AT_BONE, _FROM_BONE_MM = 8.0, 5.0
# Besides, standard deviation of a level's mean ln speed, by the square of the strain: at the deepest maps of
# these sites the means are up to 3.6 % too slow, 2.2 % root mean square at a strain of 0.36, whatever the
# size above.
_IN_LEVEL = 0.17
_RESOLVED = 0.001  # standard deviation of a part's ln speed, independent of strain
IN_MAPS, LEAST_IN_MAPS = "model: maps", 0.08  # name, and smallest fraction of the assumed error
# Standard deviation of ln mean speed where there is no map, per unit of strain and of the speeds' standard
# deviation over the region, relative to their mean: means lie 0 to 1.2 times this product below those of
# noise-free FEBio models at twelve sites, 0.6 (root mean square) at the deepest maps. Tissue that is squeezed
# against bone is fastest, and the models err most in it.
IN_MEAN = 0.6
USUAL_THICKNESS = 25.0  # mm, assumed tissue thickness where the beam meets no bone
FIRST_TOUCH = "measurement: layers at first touch"
# Standard deviation of a layer's thickness from the model error: fractions of its thinning and of the depth.
# On a block 16 mm thick, indented by 4 mm, tet10 meshes with edges of 5 to 9 mm and of 3 to 6 mm differ by
# 0.07 mm for a border 1.5 mm below the skin at rest, and by 0.02 to 0.06 mm for borders at 4 to 10 mm.
_OF_THINNING, _OF_DEPTH = 0.05, 0.02


@dataclass(frozen=True, eq=False)
class ModelError:
    """An error of the model: one standard deviation of ln force (n_levels,) and ln speed (n_levels, n_parts).

    correlation : between neighbouring levels; None: fully correlated, one common factor
    depth : mm, common shift of the depth at every level except at rest; strain : common relative error of all
    depths
    """

    name: str
    log_force: Array
    log_speed: Array
    correlation: float | None = None
    depth: float = 0.0
    strain: float = 0.0


@dataclass(frozen=True, eq=False)
class KnownErrors:
    """What is known of how far a site's model is off.

    errors : for all rows of the level table; map_share : factor on the usual model error in maps
    map_slopes (n_levels, n_parts) : 1/mm, of a model's ln speeds by depth; thickness : mm, skin to bone
    bone_as_shown : the models' bone is where the image showed it, so that a wrong speed of sound misplaces
        both
    """

    errors: Sequence[ModelError] = ()
    map_share: float = 1.0
    map_slopes: Array | None = None
    thickness: float = USUAL_THICKNESS
    bone_as_shown: bool = False


@dataclass(frozen=True, eq=False)
class MapNoise:
    """Errors of maps: the noise of the pixels, and the model's own error.

    middles (n_parts, 2) : mm, centres of the parts, lateral and below the face; size : (mm, mm) of the parts
    pitch : mm, (lateral, depth) of the pixels; pixel : their noise; strain (n_levels,) : depth over thickness
    """

    middles: Array
    size: tuple[float, float]
    pitch: tuple[float, float]
    pixel: PixelNoise
    strain: Array

    @staticmethod
    def of(windows: Windows, maps: Sequence[SweMap], noise: StatedNoise, strain: Array) -> MapNoise:
        lateral, depth = (np.concatenate([getattr(m, name) for m in maps]) for name in ("lateral", "depth"))
        size = (windows.right - windows.left) / windows.across, (windows.bottom - windows.top) / windows.down
        pixel = pixel_noise(maps, usual=noise.swe_pixel_fraction)
        return MapNoise(windows.middles, size, (pitch_of(lateral), pitch_of(depth)), pixel, strain)

    def of_pixels(self, rows: SiteRows, own: Array) -> Array:
        """Covariance (n, n) of the parts; own (n,) : standard deviations if their pixels were independent."""
        sides = [
            _side_correlation(self.pixel, np.subtract.outer(at, at), size, pitch)
            for at, size, pitch in zip(self.middles.T, self.size, self.pitch, strict=True)
        ]
        counts = [max(round(size / pitch), 1) for size, pitch in zip(self.size, self.pitch, strict=True)]
        together = self.pixel.share * sides[0] * sides[1]
        n_pixels = counts[0] * counts[1]
        together += np.eye(len(together)) * (1.0 - self.pixel.share) / n_pixels
        part, level = rows.part - 1, rows.level
        times = own * np.sqrt(n_pixels)
        same = level[:, None] == level[None, :]
        return np.asarray(np.where(same, together[np.ix_(part, part)], 0.0) * np.outer(times, times))

    def of_model(self, rows: SiteRows, share: float) -> Array:
        """Covariance (n, n) of the model error; share : factor on its usual size."""
        part, level = rows.part - 1, rows.level
        return maps_model_error(
            self.middles, part, np.abs(self.strain[level]), level, share=share,
            from_bone=self.from_unseen(part, level),
        )  # fmt: skip

    def from_unseen(self, part: IntArray, level: IntArray) -> Array:
        """Distance (n,) in mm of parts at levels (n,) from the nearest part that has no speed at that level;
        infinite if all have one."""
        shown = np.zeros((len(self.strain), len(self.middles)), bool)
        shown[level, part] = True
        apart = np.linalg.norm(self.middles[:, None] - self.middles[None], axis=2)
        nearest = np.where(shown[:, None, :], np.inf, apart[None]).min(axis=2)
        return np.asarray(nearest[level, part])


def maps_model_error(
    middles: Array, part: IntArray, strain: Array, level: IntArray, *, share: float = 1.0,
    from_bone: Array | float = np.inf,
) -> Array:  # fmt: skip
    """Covariance (n, n) of ln speeds in parts (n,) of maps at levels (n,) from the model error; middles
    (n_parts, 2) : mm, lateral and below the face; strain (n,) : depth over thickness; share : on its usual
    size; from_bone (n,) : mm, distance from what the map does not show
    """
    x, z = middles[part].T
    size = _BELOW_FACE * (_EVERYWHERE + np.exp(-(z - middles[:, 1].min()) / _FADES_MM))
    size *= 1.0 + _AT_BONE * np.exp(-from_bone / _FROM_BONE_MM)
    deviation = share * size * strain**_GROWS
    apart = np.hypot(np.subtract.outer(x, x), np.subtract.outer(z, z))
    alike = _ALIKE ** np.abs(np.subtract.outer(level, level))
    near = np.exp(-apart / _NEAR_MM) * np.outer(deviation, deviation)
    found = alike * (near + _IN_LEVEL**2 * np.outer(strain**2, strain**2))
    return np.asarray(found + (apart < 1e-9) * _RESOLVED**2)


def _side_correlation(noise: PixelNoise, apart: Array, size: float, pitch: float) -> Array:
    """Mean correlation along one side over all pairs of pixels of two parts whose centres are `apart` mm."""
    n = max(round(size / pitch), 1)
    at = (np.arange(n) - 0.5 * (n - 1)) * pitch
    distance = apart[..., None, None] + np.subtract.outer(at, at)
    if noise.smoothing <= 0:
        return np.asarray((np.abs(distance) < 1e-9).mean(axis=(-2, -1)))
    return np.asarray(np.exp(-(distance**2) / (4 * noise.smoothing**2)).mean(axis=(-2, -1)))


def noise_parts(
    seen: SiteReadings, rows: SiteRows, slope: Array, *, maps: MapNoise | None, model: KnownErrors
) -> list[NoisePart]:  # fmt: skip
    """All noise parts of a site's data.

    slope (n,) : change of each datum with depth; maps : noise of the parts of maps, if there are any
    """
    noise, protocol, keep = seen.noise, seen.protocol, seen.keep
    source, is_map = noise.source, rows.among("map")
    level = np.minimum(rows.level, len(protocol) - 1)
    exact = (protocol.force == 0.0) & (protocol.depth == 0.0)
    by_depth = np.where(exact[level], 0.0, slope) * noise.depth
    parts = [
        independent("measurement: own error of each reading", np.where(is_map, 0.0, rows.own), source=source),
        of_groups("measurement: depth, in all channels of a level", by_depth, rows.level, source=source),
    ]
    if is_map.any() and maps is not None:
        mine = rows.where(is_map)
        parts += [
            within("measurement: pixels of the maps", is_map, maps.of_pixels(mine, mine.own), source),
            within(IN_MAPS, is_map, maps.of_model(mine, model.map_share), "computed"),
            of_groups("measurement: speeds of a level", np.where(is_map, noise.swe_level_fraction, 0.0),
                      rows.level, source=source),
        ]  # fmt: skip
    speeds = rows.among("swe", "map")
    if speeds.any():
        parts.append(common(GAIN_OF_SPEEDS, np.where(speeds, COMMON_GAIN, 0.0), source="assumed"))
    for each in model.errors:
        direction = _model_direction(rows, each.log_force[keep], each.log_speed[keep])
        pressed = protocol.depth[level]  # 0 at rest: no error there
        shift = each.depth * (pressed > 0) + each.strain * pressed
        direction = direction + shift * np.where(rows.among("travel"), 0.0, slope)
        if each.correlation is None:
            parts.append(common(each.name, direction, source="computed"))
        else:
            along, alike = rows.level.astype(float), each.correlation
            parts.append(correlated(each.name, direction, along, correlation=alike, source="computed"))
    parts += layer_noise(seen.layers, protocol, rows, source)
    if seen.held is not None:
        covariance = seen.held.covariance
        parts.append(within("measurement: forces in holds", rows.among("hold"), covariance, source))
    parts += [
        within(f"model: {each.name}", rows.among(each.name), each.model_error, "computed")
        for each in seen.extras if each.model_error is not None
    ]  # fmt: skip
    if (travels := rows.among("travel")).any():
        # of the travel reading and the depth at the reference level; a depth of 0 is zero by definition
        moved = protocol.depth[seen.travel_from] != 0.0
        zero = np.hypot(TRAVEL_DEVIATION, noise.depth if moved else 0.0)
        parts.append(common("measurement: zero of the travel", zero * travels, source=source))
    return parts


def _model_direction(rows: SiteRows, log_force: Array, log_speed: Array) -> Array:
    out, forces, speeds = np.zeros(len(rows)), rows.among("force"), rows.among("swe", "map")
    out[forces] = rows.y[forces] * log_force[rows.level[forces]]
    out[speeds] = np.nan_to_num(log_speed[rows.level[speeds], rows.part[speeds]])
    return out


def depth_slopes(
    protocol: Protocol, rows: SiteRows, *, map_slopes: Array | None = None,
    layers: LayerReadings | None = None,
) -> Array:  # fmt: skip
    """Derivative of each datum with depth (n,), from smooth curves through the measured values; for parts of
    maps from a model, `map_slopes`, where given. Depth and speeds are fitted as functions of the force, which
    has little error; layers thin linearly in ln(1 + F/unit) of the smooth depth."""
    out = np.zeros(len(rows))
    smooth = SmoothDepth.through(protocol)
    for channel in rows.channels():
        mine = rows.among(channel)
        if channel == "map" and map_slopes is not None:
            out[mine] = map_slopes[rows.level[mine], rows.part[mine] - 1]
        elif channel == "travel":
            out[mine] = 1.0
        elif channel == "force":
            out[mine] = smooth.slope(protocol.force[rows.level[mine]])
        elif channel in ("swe", "map"):
            place = smooth.place(protocol.force[rows.level[mine]])
            n_places = len(np.unique(place))
            if n_places >= 2:
                curve = np.polynomial.Polynomial.fit(place, rows.y[mine], 2 if n_places > 4 else 1)
                out[mine] = curve.deriv()(place) / smooth.rate
    for layer, members in _members(rows):
        assert layers is not None
        levels = rows.level[members]
        x = np.r_[0.0, smooth.place(protocol.force[levels])]
        depth = np.r_[0.0, np.maximum(protocol.depth[levels], 0.0)]
        thickness = np.r_[layers.thickness[0, layer], rows.y[members]]
        span = float(x @ x)
        if span <= 0:
            continue
        rate, thinning = float(x @ depth) / span, float(x @ (thickness - thickness[0])) / span
        out[members] = thinning / rate if rate > 0 else 0.0
    return out


def layer_noise(
    layers: LayerReadings | None, protocol: Protocol, rows: SiteRows, source: str
) -> list[NoisePart]:
    """Common errors of the readings of one layer: of its thickness at first touch, and of the model."""
    parts = []
    for layer, members in _members(rows):
        assert layers is not None
        first, model = np.zeros(len(rows)), np.zeros(len(rows))
        first[members] = layers.deviation * layers.growth(np.maximum(rows.y[members], 0.0), layer)
        thinner = layers.thickness[0, layer] - rows.y[members]
        depth = np.maximum(protocol.depth[rows.level[members]], 0.0)
        model[members] = np.hypot(_OF_THINNING * thinner, _OF_DEPTH * depth)
        name = layers.names[layer]
        parts.append(common(f"{FIRST_TOUCH}, {name}", first, source=source))
        parts.append(common(f"model: layers, {name}", model, source="assumed"))
    return parts


def _members(rows: SiteRows) -> list[tuple[int, IntArray]]:
    mine = rows.among(LAYER)
    return [(k, np.flatnonzero(mine & (rows.part == k))) for k in np.unique(rows.part[mine]).tolist()]
