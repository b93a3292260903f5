"""Spatial variation of stiffness: c(x) = 2 rho v0(x)^2 of the level-0 wave-speed map.

The map lies in the image plane (lateral, depth). It is smoothed, extruded along elevation, and fades into its
median where nothing was measured, so that values are neither invented nor discontinuous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import cKDTree

from limbcli.errors import MeasurementError
from limbcli.measurement.elastography import SweMap
from limbcli.measurement.shear_modulus import shear_modulus_from_wave_speed
from limbcli.model import Array

SMOOTHING = 3.0  # mm, deviation of the Gaussian over the pixels (about what a wave-speed pixel averages)
FADE = 6.0  # mm, distance over which a value fades into the median outside the map
_LEAST_PIXELS = 12


@dataclass(frozen=True, eq=False)
class Stiffnesses:
    """Stiffness at given points.

    c (n_points,) : MPa; inside (n_points,) : whether each point lies in the image; median : MPa, c far from
        the image
    """

    c: Array
    inside: NDArray[np.bool_]
    median: float


def stiffness_at(swe: SweMap, points: Array, *, density_kg_per_m3: float = 1000.0) -> Stiffnesses:
    """c at points of a site's model.

    swe : the map of level 0, lateral along the model's x, depth along -z, mm
    points : (n_points, 3) mm, frame of the site's model

    Raises MeasurementError if the map has fewer than a dozen pixels or they are collinear.
    """
    if len(swe) < _LEAST_PIXELS:
        raise MeasurementError(
            f"the wave-speed map of level 0 has {len(swe)} pixels; a stiffness map needs {_LEAST_PIXELS}",
            where=str(swe.path),
            fix="fit without --stiffness-map, or export the map with more pixels",
        )
    places = np.column_stack([swe.lateral, swe.depth])
    c = 2.0 * shear_modulus_from_wave_speed(swe.speed_m_per_s, density_kg_per_m3=density_kg_per_m3)
    log_c = _smoothed(places, np.log(c))
    at = np.column_stack([points[:, 0], -points[:, 2]])
    value = _interpolated(places, log_c, at, swe)
    in_plane = np.isfinite(LinearNDInterpolator(places, np.ones(len(places)))(at))  # in the convex hull
    tree = cKDTree(places)
    outside = np.maximum(tree.query(at)[0] - np.median(tree.query(places, k=2)[0][:, 1]), 0.0)
    weight = np.exp(-0.5 * (np.where(in_plane, 0.0, outside) / FADE) ** 2)
    median = float(np.median(log_c))
    c = np.exp(weight * value + (1.0 - weight) * median)
    return Stiffnesses(c, in_plane, float(np.exp(median)))


def _smoothed(places: Array, values: Array) -> Array:
    """Gaussian average over the pixels around each pixel."""
    tree = cKDTree(places)
    near = tree.query_ball_point(places, 3.0 * SMOOTHING)
    out = np.empty_like(values)
    for k, each in enumerate(near):
        weight = np.exp(-0.5 * ((places[each] - places[k]) ** 2).sum(axis=1) / SMOOTHING**2)
        out[k] = weight @ values[each] / weight.sum()
    return out


def _interpolated(places: Array, values: Array, at: Array, swe: SweMap) -> Array:
    """Linear interpolation inside the map's convex hull, the nearest pixel's value outside."""
    if np.linalg.matrix_rank(places - places.mean(axis=0), tol=1e-6) < 2:
        raise MeasurementError(
            "the pixels of the wave-speed map lie on one line",
            where=str(swe.path),
            fix="export a map with rows and columns",
        )
    linear = LinearNDInterpolator(places, values)(at)
    return np.where(np.isnan(linear), NearestNDInterpolator(places, values)(at), linear)
