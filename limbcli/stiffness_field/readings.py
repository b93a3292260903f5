"""What is known at the sites of a limb: parameters with intervals, and maps of wave speed at rest.

A site's reading is the mean of ln c over a region below the probe, not a value at a point: over the tissue
from skin to bone within the middle two thirds of the probe's long side, evenly weighted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from limbcli.errors import FitError, MeasurementError
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.map_noise import PixelNoise
from limbcli.measurement.shear_modulus import shear_modulus_from_wave_speed
from limbcli.model import Array
from limbcli.stiffness_field.forces import ForceReading
from limbcli.stiffness_field.likelihood import Interval, likelihood_of

PARAMETERS = ("c", "m", "f_kappa")
# Possible c of soft tissue, MPa; anything else is in another unit.
_C_LIMITS = (1e-5, 1.0)
_ASIDE = (-1 / 3, 0.0, 1 / 3)  # places along the probe's long side, of its length
_DOWN = (0.1, 0.3, 0.5, 0.7, 0.9)  # depths, of the distance from skin to bone
_CELL, _MOST_CELLS = 6.0, 60  # mm, side of the squares over which a map is averaged; their largest number
_SAMPLED = 16  # pixels of a square from which the correlation of its noise with others' is computed


@dataclass(frozen=True, eq=False)
class SiteReading:
    """The parameters of one site.

    points : (q, 3) mm, the region over which the site averages, with equal weights
    values : "c" (MPa), "m", "f_kappa", those that are known, with 95 % intervals
    correlation : of ln of two parameters' errors, by their names in the order of `PARAMETERS`
    source : where the values come from, in words
    force : what the force says of all parameters together. The values of the parameters that are not
        `beside` it come from it too, and then only weight the hypotheses
    """

    name: str
    points: Array
    values: Mapping[str, Interval]
    correlation: Mapping[tuple[str, str], float] = field(default_factory=dict)
    source: str = ""
    force: ForceReading | None = None
    beside: tuple[str, ...] = ("c",)


@dataclass(frozen=True, eq=False)
class MapReading:
    """ln c from a map of wave speeds at rest, averaged over squares.

    points : (n, 3) mm; log_c : (n,) ln MPa; covariance : (n, n) of the pixels' noise in log_c
    gain_deviation : standard deviation of an error common to the whole map, in ln c; None: unknown, so that
        the map says only how c varies within it (where a site's c was obtained from the same map)
    """

    site: str
    points: Array
    log_c: Array
    covariance: Array
    gain_deviation: float | None


def region_below(
    skin_point: Array, normal: Array, long_axis: Array, *, length: float, skin_bone: float
) -> Array:
    """Points (15, 3), mm, of the tissue over which a site's reading averages.

    skin_point, normal, long_axis : (3,) of the site, unit vectors, in the frame of the limb
    length : mm, of the probe's long side; skin_bone : mm, from skin to bone (or to the limb's middle)
    """
    aside, down = (
        each.ravel() for each in np.meshgrid(np.array(_ASIDE) * length, np.array(_DOWN) * skin_bone)
    )
    return np.asarray(skin_point - down[:, None] * normal + aside[:, None] * long_axis, float)


def map_reading(
    site: str, swe: SweMap, to_patient: Array, noise: PixelNoise, *, gain_deviation: float | None,
    density_kg_per_m3: float = 1000.0,
) -> MapReading:  # fmt: skip
    """ln c = ln(2 rho v^2) of a map at rest, averaged over squares of 6 mm or, in a large map, more.

    to_patient : (4, 4) from the site's frame (lateral along x, depth along -z) to the limb's
    noise : of ln speed; the noise of neighbouring squares is correlated as that of their pixels

    Raises MeasurementError if the map has no pixels, or a speed is not positive.
    """
    if not len(swe):
        raise MeasurementError(
            "the map of wave speeds at rest has no pixels",
            where=f"site {site}",
            fix="leave the site's map out, or export it again",
        )
    log_c = np.log(
        2.0 * shear_modulus_from_wave_speed(swe.speed_m_per_s, density_kg_per_m3=density_kg_per_m3)
    )
    pixels = np.column_stack([swe.lateral, swe.depth])
    square = _squares(pixels)
    n = int(square.max()) + 1
    count = np.bincount(square, minlength=n).astype(float)
    mean = np.bincount(square, weights=log_c, minlength=n) / count
    middle = np.stack([np.bincount(square, weights=each, minlength=n) / count for each in pixels.T], axis=1)
    own = np.stack([middle[:, 0], np.zeros(n), -middle[:, 1]], axis=1)
    points = own @ to_patient[:3, :3].T + to_patient[:3, 3]
    return MapReading(site, points, mean, _noise(pixels, square, count, noise), gain_deviation)


def _squares(pixels: Array) -> Array:
    """Number of the square of each pixel (n,)."""
    side = _CELL
    while True:
        index = np.floor((pixels - pixels.min(axis=0)) / side).astype(int)
        found, number = np.unique(index, axis=0, return_inverse=True)
        if len(found) <= _MOST_CELLS:
            return np.asarray(number.ravel())
        side *= 1.2


def _noise(pixels: Array, square: Array, count: Array, noise: PixelNoise) -> Array:
    """Covariance of the squares' mean ln c: twice the deviation of ln speed, squared."""
    n, variance = len(count), (2.0 * noise.deviation) ** 2
    out = np.diag(variance * (1.0 - noise.share) / count)
    if noise.share <= 0.0:
        return out
    ends = np.r_[0, np.cumsum(count).astype(int)]
    order = np.argsort(square, kind="stable")
    chosen = [
        order[low + np.linspace(0, high - low - 1, min(high - low, _SAMPLED)).round().astype(int)]
        for low, high in pairwise(ends)
    ]
    several = np.concatenate(chosen)
    apart = np.linalg.norm(pixels[several, None] - pixels[several], axis=2)
    together = np.where(apart < 1e-9, noise.share, noise.correlation(apart))
    average = np.zeros((n, len(several)))
    average[np.repeat(np.arange(n), [len(each) for each in chosen]), np.arange(len(several))] = 1.0
    average /= average.sum(axis=1, keepdims=True)
    return np.asarray(out + variance * average @ together @ average.T)


def check_readings(sites: Sequence[SiteReading], maps: Sequence[MapReading]) -> None:
    """Refuse readings that cannot be those of one limb's sites.

    Raises FitError with the site, and what is wrong with it.
    """
    names = [each.name for each in sites]
    again = sorted({name for name in names if names.count(name) > 1})
    if again:
        raise FitError(
            f"site {again[0]} has two readings", where=f"site {again[0]}", fix="give each site once"
        )
    for site in sites:
        where = f"site {site.name}"
        _check_points(site.points, where)
        for name, interval in site.values.items():
            if name not in PARAMETERS:
                raise FitError(
                    f"{name!r} is no parameter of the field", where=where, fix=f"give {', '.join(PARAMETERS)}"
                )
            likelihood_of(interval, where=f"{name} of {where}")
        c = site.values.get("c")
        if c is not None and not _C_LIMITS[0] <= c.value <= _C_LIMITS[1]:
            raise FitError(
                f"c is {c.value:g} MPa; soft tissue has {_C_LIMITS[0]:g} to {_C_LIMITS[1]:g} MPa",
                where=where,
                fix="give c in MPa (1 kPa = 0.001 MPa)",
                c=c.value,
            )
        _check_correlation(site.correlation, where)
    for each in maps:
        where = f"map of site {each.site}"
        _check_points(each.points, where)
        if not np.isfinite(each.log_c).all() or each.covariance.shape != (len(each.log_c),) * 2:
            raise FitError(
                "the map's ln c or its covariance is not finite, or of another size than its points",
                where=where,
                fix="read the map again (`map_reading`)",
            )


def _check_correlation(correlation: Mapping[tuple[str, str], float], where: str) -> None:
    together = np.eye(len(PARAMETERS))
    for (one, other), rho in correlation.items():
        i, j = PARAMETERS.index(one), PARAMETERS.index(other)
        together[i, j] = together[j, i] = rho
    if not np.isfinite(together).all() or np.linalg.eigvalsh(together).min() < 1e-6:
        told = ", ".join(f"{one} and {other} {rho:g}" for (one, other), rho in correlation.items())
        raise FitError(
            f"no three quantities have the correlations {told}",
            where=where,
            fix="give those of one fit, each between -1 and 1, or none",
        )


def _check_points(points: Array, where: str) -> None:
    if points.ndim != 2 or points.shape[1:] != (3,) or not len(points) or not np.isfinite(points).all():
        raise FitError(
            "the region of a reading is not a list of points (n, 3)",
            where=where,
            fix="give finite coordinates in mm, in the frame of the limb's surfaces",
        )
